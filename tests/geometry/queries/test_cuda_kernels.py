"""Every Warp kernel compiles for NVIDIA GPUs. The compiler (NVRTC) is part of Warp and needs no GPU and no driver."""

import importlib
from pathlib import Path

import pytest
import warp as wp

import jaxdr

PACKAGE = Path(jaxdr.__file__).parent
MODULES = [path for path in sorted(PACKAGE.rglob("*.py")) if "@wp.kernel" in path.read_text()]
HOPPER = 90  # compute capability 9.0


def name(path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)


def compiled(module, folder) -> str:
    """The module as PTX, the assembly language of the GPU's virtual machine."""
    if HOPPER not in wp.get_cuda_supported_archs():
        pytest.skip("Warp has no CUDA compiler on this platform")
    (path,) = wp.compile_aot_module(module, arch=HOPPER, module_dir=folder, use_ptx=True)
    return path.read_text()


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_kernels_compile_for_cuda(path, tmp_path):
    module = importlib.import_module(name(path))
    ptx = compiled(module, tmp_path)
    kernels = [
        k for k, value in vars(module).items() if isinstance(value, wp.Kernel) and value.module.name == name(path)
    ]
    assert kernels
    for kernel in kernels:
        assert f".entry {kernel}" in ptx, kernel


@wp.func_native("getenv(0);")
def _of_the_host(): ...


@wp.kernel(module="unique")
def host_only():
    _of_the_host()


def test_what_does_not_compile_is_noticed(tmp_path, capfd):
    with pytest.raises(Exception, match="CUDA"):
        compiled(host_only.module, tmp_path)
    assert "getenv" in capfd.readouterr().err
