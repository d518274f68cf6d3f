"""Every kernel compiles for a GPU, on machines that have none too (NVRTC, which comes with warp)."""

from pathlib import Path
from typing import Any

import pytest
import warp as wp

from deformscope.stages.msm.anderson_kernels import anderson_kernels_for
from deformscope.stages.msm.general_kernels import general_kernels_for
from deformscope.stages.msm.lanes import members
from deformscope.stages.msm.lattice_kernels import lattice_kernels_for
from deformscope.stages.msm.multigrid_kernels import smoother_for, transfer_kernels_for
from deformscope.stages.msm.newton_kernels import newton_kernels_for
from deformscope.stages.msm.reduced_kernels import reduced_kernels_for
from deformscope.stages.msm.resident_kernels import resident_kernels_for

ARCH = 90
"""sm_90, an H100 or H200."""

GPU_WIDTH = 1
"""Lanes on a GPU: see `layout.widths`."""


GPU_WINDOWS = (3, 9, 0)
"""Cells of a cluster along every axis that kernels are made for; 0, any: see `lattice_functions_for`."""


def _kernels(kind: str, dim: int, terms: int, scalar: Any, window: int) -> list[wp.Kernel]:
    if kind in ("steps", "relax"):  # a module each
        return [getattr(resident_kernels_for(dim, scalar, GPU_WIDTH, window), kind)]
    if kind == "lattice":
        made: Any = lattice_kernels_for(dim, scalar, GPU_WIDTH, window)
    elif kind == "general":
        made = general_kernels_for(dim, terms, scalar, GPU_WIDTH)
    elif kind == "material":
        made = general_kernels_for(dim, terms, scalar, GPU_WIDTH, material=True)
    elif kind == "newton":
        made = newton_kernels_for(dim, scalar, GPU_WIDTH)
    elif kind == "anderson":
        made = anderson_kernels_for(dim, scalar, GPU_WIDTH)
    elif kind == "smoother":
        made = members(smoother_for(dim, GPU_WIDTH))
    elif kind == "transfer":
        made = transfer_kernels_for(dim, scalar)
    else:
        made = reduced_kernels_for(dim, terms)
    return [member for member in vars(made).values() if isinstance(member, wp.Kernel)]


def _modules(kernels: list[wp.Kernel]) -> dict[Any, list[str]]:
    """The modules that kernels are in, and the names of those."""
    found: dict[Any, list[str]] = {}
    for kernel in kernels:
        found.setdefault(kernel.module, []).append(kernel.key)
    return found


def _case(kind: str, dim: int, terms: int, scalar: Any, window: int = 0, *, slow: bool = True) -> Any:
    name = f"{kind}-{dim}d-{terms}-{scalar.__name__}-{window}"
    return pytest.param(kind, dim, terms, scalar, window, marks=[pytest.mark.slow] if slow else [], id=name)


QUICK = ("steps",)
"""What a quick run compiles, in space, in float32 and for the windows of most bodies; and multigrid in space."""

SCALARS = (wp.float32, wp.float64)
TERMS = {2: (2, 5), 3: (3, 9)}

CASES = [
    *(
        _case(kind, dim, dim, scalar, window, slow=(kind not in QUICK or (dim, scalar, window) != (3, wp.float32, 3)))
        for kind in ("lattice", "steps", "relax")
        for dim in (2, 3)
        for scalar in SCALARS
        for window in GPU_WINDOWS
        if kind == "lattice" or window < 9  # wide ones are for bodies too large for kernels that stay
    ),
    *(_case(kind, dim, dim, scalar) for kind in ("newton", "anderson") for dim in (2, 3) for scalar in SCALARS),
    *(_case("smoother", dim, dim, wp.float32, slow=dim == 2) for dim in (2, 3)),
    *(_case("transfer", dim, dim, wp.float64, slow=dim == 2) for dim in (2, 3)),
    *(
        _case(kind, dim, terms, scalar)
        for kind in ("general", "material")
        for dim in (2, 3)
        for terms in TERMS[dim]
        for scalar in SCALARS
    ),
    *(_case("reduced", dim, terms, wp.float64) for dim in (2, 3) for terms in TERMS[dim]),
]


@pytest.mark.parametrize(("kind", "dim", "terms", "scalar", "window"), CASES)
def test_every_kernel_compiles_for_a_gpu(
    tmp_path: Path, kind: str, dim: int, terms: int, scalar: Any, window: int
) -> None:
    wp.config.quiet = True
    wp.init()
    if ARCH not in wp.get_cuda_supported_archs():
        pytest.skip(f"this warp has no NVRTC that compiles for sm_{ARCH}")
    modules = _modules(_kernels(kind, dim, terms, scalar, window))
    assert modules
    for module, names in modules.items():
        compiled = wp.compile_aot_module(module, arch=ARCH, module_dir=tmp_path, use_ptx=True)
        text = "".join(path.read_text() for path in map(Path, compiled) if path.suffix == ".ptx")
        assert f".target sm_{ARCH}" in text
        for name in names:
            assert f"{name}_" in text, name
