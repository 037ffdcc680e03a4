"""Small, fast programs: their size, the time until a first gradient, and rates against Mitsuba's.

    python -m experiments.compilation.run --tree runs/before

Every part is measured for this version and for the other versions whose checkouts `--tree` names, in turns.
"""

from pathlib import Path

from experiments import common
from experiments.compilation import options as compiler_options
from experiments.compilation import oracles, rates, scenes, size
from experiments.compilation.trees import versions

PARTS = {"size": size.main, "rates": rates.main, "oracles": oracles.main, "options": compiler_options.main}


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--part", choices=PARTS, action="append", help="may be repeated; default: all")
    parser.add_argument("--tree", type=Path, action="append", default=[], help="checkout of another version to compare")
    parser.add_argument(
        "--case", choices=scenes.CASES, action="append", help="of `size`; may be repeated; default: all"
    )
    parser.add_argument("--scene", choices=oracles.SCENES, action="append", help="of `oracles`; may be repeated")
    parser.add_argument("--jit", choices=size.JITS, action="append", help="of `size`; may be repeated; default: both")
    parser.add_argument("--no-compile", action="store_true", help="`size` counts and lowers, and compiles nothing")
    options = parser.parse_args()
    found = versions(options.tree)
    tables = [PARTS[part](options, found) for part in options.part or PARTS]
    print("\n" + "\n\n".join(tables))


if __name__ == "__main__":
    main()
