"""Rows of tables whose derivative a GPU can add up fast."""

import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped

from jaxdr.sizes import at_once

# A GPU adds to one address about once a clock tick. If a million paths meet a floor of two faces, all their derivatives
# add to two rows, and most threads wait. So neighbouring rows of `index` read from different copies of the table.
COPIES = 32
MOST_NUMBERS = 1 << 22  # in all copies: 16 MB, which caches of large GPUs hold
FEW = 1 << 12  # so few rows do not wait for each other


def rows_of(table: Shaped[Array, "V *d"], index: Int[Array, "*k"]) -> Shaped[Array, "..."]:
    """`table[index]`, [*k, *d]. On a GPU the transpose adds into several copies of a small table, and sums these."""
    count, copies = table.shape[0], at_once(cpu=1, gpu=min(COPIES, MOST_NUMBERS // max(table.size, 1)))
    if copies <= 1 or index.ndim == 0 or index.shape[0] < FEW:
        return table[index]
    first = count * (jnp.arange(index.shape[0], dtype=index.dtype) % copies)
    tables = jnp.broadcast_to(table, (copies, *table.shape)).reshape(copies * count, *table.shape[1:])
    return tables[index + first.reshape(-1, *[1] * (index.ndim - 1))]
