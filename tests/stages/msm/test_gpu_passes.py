"""The passes of a GPU, which sum whole windows, run on the CPU: against its own lanes."""

from collections.abc import Iterator

import numpy as np
import pytest
import warp as wp
from scipy.sparse import block_diag, csr_array

from deformscope.stages.msm import lattice as lattice_module
from deformscope.stages.msm.clusters import lattice
from deformscope.stages.msm.layout import upload
from deformscope.stages.msm.multigrid_kernels import Cells, Transfer, gather_kernel_for
from deformscope.stages.msm.solver import Msm


@pytest.fixture(params=["one block", "launch by launch"])
def as_on_a_gpu(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Plain numbers in place of lanes; without threads, every pass is a launch, as of a large body."""
    monkeypatch.setattr(lattice_module, "widths", lambda *_given, **_named: (1, 1))
    if request.param == "launch by launch":
        made = lattice_module.LatticeOperator.__init__

        def without_threads(self: lattice_module.LatticeOperator, *given: object) -> None:
            made(self, *given)  # type: ignore[arg-type]
            self.threads = 0

        monkeypatch.setattr(lattice_module.LatticeOperator, "__init__", without_threads)
    yield monkeypatch
    monkeypatch.undo()


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "size"), [((4, 5, 6), 3), ((4, 4, 5), 2), ((7, 15), 5)])
def test_whole_windows_move_and_settle_as_sums_along_each_axis(
    as_on_a_gpu: pytest.MonkeyPatch, shape: tuple[int, ...], size: int
) -> None:
    rest = np.indices(shape, dtype=float).reshape(len(shape), -1).T
    held = np.flatnonzero((rest[:, 0] == 0) | (rest[:, 0] == shape[0] - 1))
    place = rest[held] + np.where(rest[held, :1] > 0, 0.2, 0.0)
    start = rest + 0.02 * np.random.default_rng(3).standard_normal(rest.shape)
    push = [0.1] * len(shape)

    def found() -> list[np.ndarray]:
        body = Msm(rest, lattice(rest, shape, np.arange(len(rest)), size), held)
        betas = np.array([0.1, 0.6, 0.9])
        state = body.start(3, start)
        positions = [body.step(state, place, betas, steps=5, acceleration=push)]
        positions.append(body.step(state, place, betas, steps=4, dt=1e-3))  # another share of the last motion continues
        positions.append(body.step(state, place + 0.01, betas, steps=3, dt=1e-3, held_from=place))
        return [*positions, body.relax(place, betas).position]

    whole = found()
    as_on_a_gpu.undo()
    for got, expected in zip(whole, found(), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-10)


def test_copied_positions_stay_as_they_are_while_any_part_of_them_is_in_use(device: str) -> None:
    rest = np.indices((6, 6, 6), dtype=float).reshape(3, -1).T
    held = np.flatnonzero(rest[:, 0] == 0)
    body = Msm(rest, lattice(rest, (6, 6, 6), np.arange(len(rest)), 3), held, precision="float32", device=device)
    state = body.start(2)
    kept = []
    for turn in range(6):
        found = body.step(state, rest[held], 0.5, steps=3, acceleration=[0.0, 0.0, 0.3])
        kept.append((found[turn % 2, ::7], found[turn % 2, ::7].copy()))
    for part, copied in kept:
        np.testing.assert_array_equal(part, copied)
    assert len({tuple(copied[-1]) for _part, copied in kept}) == 6  # it did move


@pytest.mark.parametrize(("fine", "coarse"), [((7, 5, 9), (4, 3, 5)), ((6, 8), (3, 4)), ((1, 12, 5), (1, 6, 3))])
def test_a_transfer_of_a_gpu_weighs_the_planes_of_each_axis(fine: tuple[int, ...], coarse: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    to_fine = [_hats(many, few) for many, few in zip(fine, coarse, strict=True)]
    for matrices, source, target in ((to_fine, coarse, fine), ([each.T for each in to_fine], fine, coarse)):
        values, more = rng.standard_normal((2, 3, *source))
        source_weight, target_weight = rng.random(source), rng.random(target)
        target_weight[target_weight < 0.3] = 0.0
        expected = (values + more) * source_weight
        for axis, matrix in enumerate(matrices):
            expected = np.moveaxis(np.tensordot(matrix, expected, axes=(1, axis + 1)), 0, axis + 1)
        found = _gathered(matrices, values, more, source_weight, target_weight)
        np.testing.assert_allclose(found, expected * target_weight, atol=2e-6)


def _hats(many: int, few: int) -> np.ndarray:
    """(many, few): shares of the coarse places at each fine one, by linear interpolation."""
    place = np.arange(many) * (few - 1) / max(many - 1, 1)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(few)))


def _gathered(matrices: list[np.ndarray], values: np.ndarray, more: np.ndarray, *weights: np.ndarray) -> np.ndarray:
    """What the kernel makes of fields (3, *source)."""
    both = block_diag([csr_array(each) for each in matrices], format="csr")
    transfer = Transfer()
    transfer.begin, transfer.plane = upload(both.indptr, int, "cpu"), upload(both.indices, int, "cpu")
    transfer.weight = upload(both.data, wp.float32, "cpu")
    if len(matrices) == 2:  # one plane along the first axis
        return _gathered([np.ones((1, 1)), *matrices], values[:, None], more[:, None], *(w[None] for w in weights))[
            :, 0
        ]
    places = []
    for shape in (values.shape[1:], weights[1].shape):
        place = Cells()
        place.cells_0, place.cells_1, place.cells_2 = shape
        place.abreast, place.group, place.stride = 1, int(np.prod(shape)), int(np.prod(shape))
        places.append(place)
    out = wp.zeros(3 * weights[1].size, dtype=wp.float32, device="cpu")
    given = [upload(each, wp.float32, "cpu") for each in (values, more, *weights)]
    most = int(np.diff(both.indptr).max())
    found: list[np.ndarray] = []
    for rows_each in (1, 3):
        threads = (1, 3 // rows_each, weights[1].size)
        wp.launch(gather_kernel_for(rows_each, most), threads, [transfer, *places, *given], [out], device="cpu")
        found.append(out.numpy().reshape(3, *weights[1].shape).copy())
    np.testing.assert_array_equal(found[0], found[1])
    return found[0]
