"""Every kernel compiles for a GPU, on machines that have none too (NVRTC, which comes with warp)."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("warp")

import warp as wp

from deformscope.stages.msm.general_kernels import general_kernels_for
from deformscope.stages.msm.iteration_kernels import iteration_kernels_for
from deformscope.stages.msm.lattice_kernels import lattice_kernels_for
from deformscope.stages.msm.reduced_kernels import reduced_kernels_for

ARCH = 90
"""sm_90, an H100 or H200."""

GPU_WIDTH = 1
"""Lanes on a GPU: see `layout.widths`."""


def _kernels(kind: str, dim: int, terms: int, scalar: Any) -> Any:
    if kind == "lattice":
        return lattice_kernels_for(dim, scalar, GPU_WIDTH)
    if kind == "general":
        return general_kernels_for(dim, terms, scalar, GPU_WIDTH)
    if kind == "iteration":
        return iteration_kernels_for(dim, scalar, GPU_WIDTH)
    return reduced_kernels_for(dim, terms)


def _modules(kernels: Any) -> dict[Any, list[str]]:
    """The modules that a set's kernels are in, and the names of those."""
    found: dict[Any, list[str]] = {}
    for field in dataclasses.fields(kernels):
        member = getattr(kernels, field.name)
        if isinstance(member, wp.Kernel):
            found.setdefault(member.module, []).append(member.key)
    return found


def _case(kind: str, dim: int, terms: int, scalar: Any, *, slow: bool) -> Any:
    marks = [pytest.mark.slow] if slow else []
    return pytest.param(kind, dim, terms, scalar, marks=marks, id=f"{kind}-{dim}d-{terms}-{scalar.__name__}")


REST = [(2, wp.float32), (2, wp.float64), (3, wp.float64)]
"""What a quick run leaves out."""

CASES = [
    _case("lattice", 3, 3, wp.float32, slow=False),
    _case("general", 3, 9, wp.float32, slow=False),
    _case("iteration", 3, 3, wp.float32, slow=False),
    _case("general", 3, 3, wp.float32, slow=True),
    *(_case("lattice", dim, dim, scalar, slow=True) for dim, scalar in REST),
    *(_case("iteration", dim, dim, scalar, slow=True) for dim, scalar in REST),
    *(_case("general", dim, terms, scalar, slow=True) for dim, scalar in REST for terms in ((2, 5), (3, 9))[dim - 2]),
    *(_case("reduced", dim, terms, wp.float64, slow=True) for dim in (2, 3) for terms in ((2, 5), (3, 9))[dim - 2]),
]


@pytest.mark.parametrize(("kind", "dim", "terms", "scalar"), CASES)
def test_every_kernel_compiles_for_a_gpu(tmp_path: Path, kind: str, dim: int, terms: int, scalar: Any) -> None:
    wp.config.quiet = True
    wp.init()
    if ARCH not in wp.get_cuda_supported_archs():
        pytest.skip(f"this warp has no NVRTC that compiles for sm_{ARCH}")
    modules = _modules(_kernels(kind, dim, terms, scalar))
    assert modules
    for module, names in modules.items():
        compiled = wp.compile_aot_module(module, arch=ARCH, module_dir=tmp_path, use_ptx=True)
        text = "".join(path.read_text() for path in map(Path, compiled) if path.suffix == ".ptx")
        assert f".target sm_{ARCH}" in text
        for name in names:
            assert f"{name}_" in text, name
