"""Pair files: what is read, what is inferred, and what is refused."""

import io
import pickle
from typing import Any

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.files.pairs import parse_pair
from tests.stages.bodies import lattice


def packed(**arrays: Any) -> bytes:
    raw = io.BytesIO()
    np.savez(raw, **arrays)
    return raw.getvalue()


def pair(**changed: Any) -> bytes:
    """A valid pair, with some arrays replaced; None leaves one out."""
    rest = lattice((3, 4))
    arrays = {"rest": rest, "deformed": rest + 1e-4, "held": np.array([0, 1, 2, 3])} | changed
    return packed(**{name: value for name, value in arrays.items() if value is not None})


def test_a_regular_rest_shape_is_taken_as_a_lattice() -> None:
    seen = parse_pair(pair())
    assert seen.shape == (3, 4)
    assert seen.cell is not None
    assert np.array_equal(seen.cell, np.arange(12))
    assert seen.observed.all()
    assert seen.noise is None
    assert seen.unit == "m"


def test_holes_need_their_cells() -> None:
    rest = np.delete(lattice((3, 4)), 5, axis=0)
    cell = np.delete(np.arange(12), 5)
    seen = parse_pair(pair(rest=rest, deformed=rest + 1e-4, shape=np.array([3, 4]), cell=cell))
    assert seen.shape == (3, 4)
    assert np.array_equal(seen.cell, cell)
    with pytest.raises(InputError, match="cell"):
        parse_pair(pair(rest=rest, deformed=rest + 1e-4, shape=np.array([3, 4])))


def test_a_cloud_stands_on_no_lattice() -> None:
    rest = np.random.default_rng(0).uniform(0, 0.1, (20, 3))
    assert parse_pair(pair(rest=rest, deformed=rest)).shape is None


def test_noise_may_be_one_number_or_each_particles_own() -> None:
    one = parse_pair(pair(noise_m=2e-4)).noise
    assert one is not None
    np.testing.assert_array_equal(one, np.full(12, 2e-4))
    each = np.linspace(1e-4, 2e-4, 12)
    np.testing.assert_array_equal(parse_pair(pair(noise_m=each)).noise, each)
    np.testing.assert_array_equal(parse_pair(pair(noise_m=each), noise_m=1e-3).noise, np.full(12, 1e-3))


def test_held_positions_are_exact_measured_or_unknown() -> None:
    assert parse_pair(pair()).held_measured is None
    assert parse_pair(pair(held_noise_m=0.0)).held_measured is False
    seen = parse_pair(pair(noise_m=1e-4, held_noise_m=3e-4))
    assert seen.held_measured is True
    np.testing.assert_array_equal(seen.noise[seen.held], 3e-4)
    assert seen.noise[11] == 1e-4


def test_held_and_contact_may_be_masks() -> None:
    held = np.zeros(12, dtype=bool)
    held[[0, 1, 11]] = True
    seen = parse_pair(pair(held=held, force_n=-2.5, contact=np.array([11])))
    assert seen.held.tolist() == [0, 1, 11]
    assert seen.force_n == 2.5
    assert seen.contact.tolist() == [11]


def test_force_acts_on_what_moved_most_unless_told() -> None:
    deformed = lattice((3, 4))
    deformed[10:] += 1e-3
    deformed[0] += 4e-4
    seen = parse_pair(pair(deformed=deformed, held=np.array([0, 1, 10, 11]), force_n=1.0))
    assert seen.contact.tolist() == [10, 11]


REST = lattice((3, 4))
NAN = REST.copy()
NAN[5, 0] = np.nan


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"rest": None}, "rest"),
        ({"deformed": None, "held": None}, "deformed and held"),
        ({"rest": REST[:, :1]}, r"\(K, 2\)"),
        ({"deformed": REST[:-1]}, "rest's shape"),
        ({"deformed": NAN}, "NaN"),
        ({"rest": NAN}, "NaN"),
        ({"rest": np.concatenate([REST[:1], REST[:-1]])}, "duplicate"),
        ({"held": np.array([], dtype=int)}, "at least one held"),
        ({"held": np.arange(12)}, "some free"),
        ({"held": np.array([0, 12])}, "0 to 11"),
        ({"held": np.array([-1, 2])}, "0 to 11"),
        ({"held": np.array([0.5, 2.0])}, "whole-number"),
        ({"held": np.array([1, 1])}, "once"),
        ({"shape": np.array([3, 5])}, "lattice shape"),
        ({"shape": np.array([0, 12])}, "lattice shape"),
        ({"observed": np.ones(5, dtype=bool)}, "observed"),
        ({"observed": np.zeros(12, dtype=bool)}, "observed"),
        ({"noise_m": -1.0}, "noise_m"),
        ({"noise_m": np.nan}, "noise_m"),
        ({"noise_m": np.ones(5)}, "noise_m"),
        ({"held_noise_m": -1.0}, "held_noise_m"),
        ({"force_n": np.nan}, "force_n"),
        ({"force_n": 1.0, "contact": np.array([7])}, "among the held"),
        ({"rest": REST.astype("U8")}, "numbers in rest"),
    ],
)
def test_bad_pairs_are_refused_in_one_line(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        parse_pair(pair(**changed), "some.npz")
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith("some.npz")


@pytest.mark.parametrize("raw", [b"", b"not a zip file", pair()[:200], pickle.dumps([1, 2])])
def test_damaged_files_are_refused(raw: bytes) -> None:
    with pytest.raises(InputError, match="pair file"):
        parse_pair(raw, "bad.npz")


def test_pickled_objects_are_never_loaded() -> None:
    with pytest.raises(InputError, match=r"numbers or texts in rest; got Python objects \(pickle\)"):
        parse_pair(packed(rest=np.array([{}], dtype=object), deformed=REST, held=np.array([0])))


def test_where_the_tip_was_is_read_and_refused_without_a_tip() -> None:
    rest = lattice((3, 4))
    tip = {"tip": np.array("disc"), "tip_size_m": np.array([0.01])}
    middle = rest.mean(axis=0)
    assert parse_pair(pair(**tip)).tip_at is None
    seen = parse_pair(pair(**tip, tip_at_m=middle))
    assert seen.tip_at is not None
    np.testing.assert_array_equal(seen.tip_at, middle)
    for changed in ({"tip_at_m": middle}, tip | {"tip_at_m": middle[:1]}, tip | {"tip_at_m": middle * np.nan}):
        with pytest.raises(InputError, match="tip_at_m"):
            parse_pair(pair(**changed))
