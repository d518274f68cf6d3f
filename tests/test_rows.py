"""Any frozen dataclass of ours comes back from a recording's columns as it was."""

import dataclasses
import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from typing_extensions import TypeAliasType

from deformscope.arrays import BoolArray, FloatArray, ImageArray, IntArray
from deformscope.frames import Stream
from deformscope.images import encode_png
from deformscope.rows import field_of, from_components, from_json, to_columns, to_components, to_json
from tests.log import synthetic_rig as rig

Number = TypeVar("Number", bound=np.generic)


class Grip(enum.Enum):
    OPEN = 1
    CLOSED = 2


@dataclass(frozen=True, slots=True)
class Inner:
    ticks: int | None
    grip: Grip = Grip.OPEN


@dataclass(frozen=True, slots=True)
class Everything:
    real: float
    whole: int
    flag: bool
    word: str
    grip: Grip
    raw: bytes
    inner: Inner
    numbers: FloatArray
    labels: IntArray | None
    mask: BoolArray
    pads: tuple[FloatArray, ...]
    pair: tuple[float, float]
    maybe_pair: tuple[float, float] | None
    words: tuple[str, ...]
    maybe_words: tuple[str, ...] | None
    counts: Mapping[str, int] = field(default_factory=dict)
    looks: tuple[tuple[str, Inner], ...] = ()
    maybe_inner: Inner | None = None
    choice: Literal["left", "right"] = "right"


FULL = Everything(
    *(math.nan, -(2**63), True, "weil's so ist: |µ|\n", Grip.CLOSED, b"\0\xff", Inner(None, Grip.CLOSED)),
    *(np.arange(24.0).reshape(2, 3, 4), np.array([[7]], np.uint16), np.array([[True, False]])),
    *((np.ones((2, 3)), np.zeros((0, 4)), np.ones(5)), (1.0, -0.0), (math.inf, 5e-324), ("a", ""), ()),
    *({"x": 2}, (("left", Inner(3)), ("", Inner(None))), Inner(1)),
)
BARE = dataclasses.replace(
    FULL,
    labels=None,
    maybe_pair=None,
    maybe_words=None,
    maybe_inner=None,
    inner=Inner(5),
    words=(),
    pads=(),
    raw=b"",
    word="",
    numbers=np.zeros((0, 3, 1)),
    real=1 / 3,
    counts={},
    looks=(),
)


def assert_equal(found: Any, expected: Any) -> None:
    assert type(found) is type(expected)
    if isinstance(expected, np.ndarray):
        assert (found.dtype, found.shape, found.tobytes()) == (expected.dtype, expected.shape, expected.tobytes())
    elif dataclasses.is_dataclass(expected):
        for one in dataclasses.fields(expected):
            assert_equal(getattr(found, one.name), getattr(expected, one.name))
    elif isinstance(expected, tuple):
        assert len(found) == len(expected)
        for inner, other in zip(found, expected, strict=True):
            assert_equal(inner, other)
    elif isinstance(expected, float):
        assert np.float64(found).tobytes() == np.float64(expected).tobytes()
    else:
        assert found == expected


@pytest.mark.parametrize("item", [FULL, BARE], ids=["full", "bare"])
def test_one_object(item: Everything) -> None:
    assert_equal(from_components(Everything, to_components(item)), item)


def test_many_rows_at_once() -> None:
    items = [FULL, BARE, BARE, FULL]
    columns = to_columns(items)
    assert columns["numbers_shape"].values.to_pylist()[:6] == [2, 3, 4, 0, 3, 1]
    for row, item in enumerate(items):
        cut = {}
        for name, column in columns.items():
            start = int(column.lengths[:row].sum())
            cut[name] = column.values.to_numpy(zero_copy_only=False)[start : start + column.lengths[row]]
        assert_equal(from_components(Everything, cut), item)


def test_none_is_left_out_and_an_array_of_one_axis_has_no_shape() -> None:
    assert not {"labels", "labels_shape", "maybe_pair", "maybe_inner"} & set(to_components(BARE))
    assert set(to_components(rig.arm(0), leave_out=("device",))) == {
        *("stamp.host_ns", "index", "joint_deg", "joint_velocity_deg_s", "joint_torque_nm", "position_m"),
        *("rotation_rad", "force_n", "torque_nm", "finger", "queued"),
    }


@pytest.mark.parametrize("missing", ["whole", "numbers", "inner.grip", "counts"])
def test_a_missing_part_is_an_error(missing: str) -> None:
    parts = to_components(FULL)
    del parts[missing]
    with pytest.raises(KeyError):
        from_components(Everything, parts)


@dataclass(frozen=True, slots=True)
class Seen:
    index: int
    image: ImageArray
    tint: ImageArray | None = None


def test_images_are_read_from_their_encoded_bytes() -> None:
    image = np.arange(48, dtype=np.uint16).reshape(6, 8)
    encoded: npt.NDArray[np.uint8] = np.frombuffer(encode_png(image), np.uint8)
    parts = to_components(Seen(3, image)) | {"image": encoded}
    assert set(parts) == {"index", "image"}  # its twin writes it
    assert_equal(from_components(Seen, parts), Seen(3, image))
    del parts["index"]
    again = from_components(Seen, parts, {"index": 3}, lambda raw, which: (raw, which))
    assert again.image == (encoded.tobytes(), "image 3 of Seen")
    assert cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED).dtype == np.uint16


def test_what_is_known_of_a_device_is_json() -> None:
    streams = [*rig.STREAMS, Stream("a", "arm", "jaco", urdf=Path("/x/y.urdf"))]
    assert [from_json(Stream, to_json(one)) for one in streams] == streams


def test_an_alias_of_an_array_is_an_array() -> None:
    """NumPy 2.5 has such an alias for NDArray. Read as a value, it ended exports of recordings."""
    named = TypeAliasType("named", np.ndarray[Any, np.dtype[Number]], type_params=(Number,))  # type: ignore[misc,valid-type]
    of = field_of(dataclasses.make_dataclass("Aliased", [("numbers", named[np.float64])]), "numbers")
    assert of.form == "array"
