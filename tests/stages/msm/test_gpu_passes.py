"""The passes of a GPU, which sum whole windows, run on the CPU: against its own lanes."""

from collections.abc import Iterator

import numpy as np
import pytest

from deformscope.stages.msm import lattice as lattice_module
from deformscope.stages.msm.clusters import lattice
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
