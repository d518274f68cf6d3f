"""Motion files: what is read, and what is refused."""

import io
from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.motions import parse_motion
from tests.stages.bodies import lattice


def _bytes(**change: Any) -> bytes:
    rest = lattice((4, 3))
    arrays = {"rest": rest, "motion": np.repeat(rest[None], 5, axis=0), "held": np.arange(3)} | change
    file = io.BytesIO()
    np.savez(file, **{name: value for name, value in arrays.items() if value is not None})
    return file.getvalue()


def test_what_is_held_and_how_long_a_frame_lasts() -> None:
    motion = parse_motion(_bytes(dt=0.1, noise_m=1e-4))
    assert motion.held.shape == (5, 12)
    assert motion.held.sum(axis=1).tolist() == [3] * 5
    assert motion.duration is not None
    np.testing.assert_array_equal(motion.duration, [0.1] * 5)
    assert motion.shape == (4, 3)
    assert motion.noise == 1e-4
    changing = np.zeros((5, 12), dtype=bool)
    changing[:, :3] = True
    changing[:3, 11] = True
    motion = parse_motion(_bytes(held=changing, dt=np.array([0.1, 0.2, 0.3, 0.4])), noise_m=2e-4)
    np.testing.assert_array_equal(motion.held, changing)
    assert motion.duration is not None
    np.testing.assert_array_equal(motion.duration, [0.1, 0.2, 0.3, 0.4, 0.4])
    assert motion.noise == 2e-4
    assert parse_motion(_bytes()).duration is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"motion": None}, "motion in the motion file"),
        ({"rest": np.zeros((12, 4))}, r"rest of shape \(K, 2\)"),
        ({"motion": np.zeros((12, 2))}, r"motion of shape \(T, 12, 2\)"),
        ({"motion": np.zeros((1, 12, 2))}, "T from 2"),
        ({"motion": np.full((5, 12, 2), np.nan)}, "positions of the held particles"),
        ({"held": np.array([50])}, "indices 0 to 11 in held"),
        ({"dt": 0.0}, "one dt above 0, or 4"),
        ({"dt": np.ones(7)}, "one dt above 0, or 4"),
        ({"noise_m": -1.0}, "noise_m of 0 or more"),
        ({"rest": np.array(["a"])}, "numbers in rest"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_file_s_name(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        parse_motion(_bytes(**change), "press.npz")
    assert "press.npz" in str(refused.value)


def test_a_file_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="a motion file"):
        parse_motion(b"no zip", "press.npz")
