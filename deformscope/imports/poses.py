"""Where an arm's end is at a time: from messages of poses, from trees of transforms, and from numbers of a table."""

import bisect
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.imports.import_map import ASKED, MappedStream
from deformscope.imports.readers import Message, Reader

Pose = npt.NDArray[np.float64]
"""Pose (4, 4) of the arm's end in the base frame [m]."""
STATIC = "tf_static"
QUATERNIONS = {"xyzw": [0, 1, 2, 3], "wxyz": [1, 2, 3, 0]}
"""Orders of four numbers, and the places of x, y, z, w in them."""
ROTATIONS = 'vector (axis times angle), or the order of Euler angles: "xyz" about fixed axes, "XYZ" about turned ones'
EULER = re.compile(r"([xyz])(?!\1)([xyz])(?!\2)[xyz]|([XYZ])(?!\3)([XYZ])(?!\4)[XYZ]")
FARTHEST_M = 1e9
"""Largest coordinate: those of a map of the earth are below 1e8."""
LENGTH_OFF = 0.01
"""Largest difference of a quaternion's length from 1: its numbers may have few digits."""


def pose_of(value: Any) -> Pose:
    """(4, 4) of a transform message, or a pose. Raises AttributeError if it has no pose, ValueError for no rotation."""
    while hasattr(value, "pose"):  # of a pose with a stamp, with a covariance, of an odometry
        value = value.pose
    value = getattr(value, "transform", value)
    turn, place = getattr(value, "rotation", None), getattr(value, "translation", None)
    turn, place = (value.orientation, value.position) if turn is None or place is None else (turn, place)
    return pose_from([turn.x, turn.y, turn.z, turn.w], [place.x, place.y, place.z])


def pose_from(quaternion: Sequence[float], position: Sequence[float]) -> Pose:
    """(4, 4) of x, y, z, w and metres. Raises ValueError for a quaternion that is no rotation."""
    from scipy.spatial.transform import Rotation

    if not abs((length := math.hypot(*quaternion)) - 1.0) <= LENGTH_OFF:
        raise ValueError(f"a quaternion of length {length:.4g}, where a rotation has 1")
    if (far_m := float(np.abs(position).max())) > FARTHEST_M:
        raise ValueError(f"a position of {far_m:.4g} m, beyond any arm")
    T: Pose = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), position
    return T


def rotation_from(form: str, numbers: Sequence[float], axes: str) -> FloatArray:
    """(3, 3) of three or four numbers [rad]. form: as `rotation` of the map; axes: the axes that the numbers are named
    by, or empty. Raises ValueError for numbers of another form."""
    from scipy.spatial.transform import Rotation

    if len(numbers) != (4 if form in QUATERNIONS else 3):
        raise ValueError(f"{len(numbers)} numbers of a rotation, which is {form!r}")
    if form in QUATERNIONS:
        return pose_from([numbers[at] for at in QUATERNIONS[form]], [0.0, 0.0, 0.0])[:3, :3]
    if not np.abs(numbers).max() < 2.01 * math.pi:
        raise ValueError(f"an angle of {np.abs(numbers).max():.4g} rad, beyond a turn: are its units deg?")
    if form == "vector":
        return np.asarray(Rotation.from_rotvec(numbers).as_matrix())
    ordered = [numbers[axes.index(axis)] for axis in form.lower()] if axes else numbers
    return np.asarray(Rotation.from_euler(form, ordered).as_matrix())


def check_rotation(stream: MappedStream, count: int, axes: str, known: str) -> str:
    """The form of a table's rotation. count: number of its numbers; axes: as above; known: the form that its columns'
    names have, or empty. Raises InputError where the map has to say it."""
    form = stream.rotation or known
    if known and form != known:
        raise stream.missing("rotation", f"{known}, as the names of its columns say", form, f'rotation = "{known}"')
    is_one = form in QUATERNIONS if count == 4 else form == "vector" or EULER.fullmatch(form)
    if not is_one:
        expected = 'the order of its four numbers, "xyzw" or "wxyz"' if count == 4 else ROTATIONS
        raise stream.missing("rotation", expected, form, f'rotation = "{"xyzw" if count == 4 else "vector"}"')
    if axes and EULER.fullmatch(form) and len({*form}) < 3:
        expected = f"rotation_0_rad to rotation_2_rad: {form} has two angles about {form[0]}"
        raise stream.missing("columns of rotation_rad", expected, "x, y and z")
    return form


@dataclass(slots=True)
class _Link:
    """A frame in its parent. times, values: newest last; a link that does not move has the time infinity"""

    parent: str
    times: list[float] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, ns: float, value: Any, needed_ns: float) -> None:
        """needed_ns: no pose is needed for a time before it"""
        if ns == math.inf:
            self.times, self.values = [ns], [value]
        elif not self.times or ns > self.times[-1]:
            self.times.append(ns)
            self.values.append(value)
            old = max(bisect.bisect_right(self.times, needed_ns) - 1, 0)
            del self.times[:old], self.values[:old]

    def at(self, ns: int) -> tuple[Pose, float]:
        """The pose at a time, and how far in time it is from those that it is computed from [ns]."""
        after = bisect.bisect_left(self.times, ns)
        if after in (0, len(self.times)) or self.times[after] in (ns, math.inf):
            after = min(after, len(self.times) - 1)
            apart_ns = 0.0 if self.times[after] == math.inf else abs(self.times[after] - ns)
            return pose_of(self.values[after]), apart_ns
        from scipy.spatial.transform import Rotation, Slerp

        (before_ns, after_ns), both = self.times[after - 1 : after + 1], self.values[after - 1 : after + 1]
        (one, other), share = map(pose_of, both), (ns - before_ns) / (after_ns - before_ns)
        T: Pose = (1 - share) * one + share * other
        T[:3, :3] = Slerp([0, 1], Rotation.from_matrix([one[:3, :3], other[:3, :3]]))(share).as_matrix()
        nearer = min if np.array_equal(one, other) else max  # a link that does not move may be repeated rarely
        return T, nearer(ns - before_ns, after_ns - ns)


class Poses:
    """Poses of an arm's end, from the topic `pose` of the map. when: the time of a message [ns]

    Raises InputError where parent and child are not said, or no chain of transforms joins them."""

    def __init__(self, stream: MappedStream, reader: Reader, when: Callable[[Message], int]) -> None:
        self._stream, self._when, self._links = stream, when, dict[str, _Link]()
        self._type = reader.topics[stream.pose].type
        above = stream.pose.rpartition("/")[0]
        first = next(iter(reader.messages([stream.pose])), None)
        has_frames = first is None or any(hasattr(first.value, one) for one in ("transforms", "child_frame_id"))
        if stream.child and not has_frames:
            raise stream.missing("child", f"none: {stream.pose} has poses without frames of their own", stream.child)
        self._is_tree = bool(stream.child) or (first is not None and hasattr(first.value, "transforms"))
        for key, name in {"parent": "base", "child": "end"}.items() if self._is_tree else ():
            if getattr(stream, key) in ("", ASKED):
                links = getattr(first and first.value, "transforms", ())
                names = dict.fromkeys(name for one in links for name in (one.header.frame_id, one.child_frame_id))
                expected = (
                    f"a frame of the transforms: the arm's {name}; {stream.pose} has {', '.join(names)}, and more"
                )
                raise stream.missing(key, expected, ASKED, f'{key} = "FRAME"')
        self._parent, self._child = stream.parent.lstrip("/"), stream.child.lstrip("/")
        fixed = {f"{above}/{STATIC}", f"/{STATIC}"} & {*reader.topics} if self._is_tree else set()
        for message in reader.messages(fixed):
            self.follow(message, math.inf)
        before = dict(self._links)
        for message in reader.messages([stream.pose]) if self._is_tree else ():
            self.follow(message, math.inf)
            if self._chain() is not None:
                break
        if self._is_tree and self._chain() is None:
            trees = ", ".join(f"{name} in {link.parent}" for name, link in self._links.items()) or "no transforms"
            expected = f"frames of which transforms of {stream.pose} lead from {self._child} up to {self._parent}"
            raise stream.missing("parent and child", expected, trees[:400])
        self._links = before  # those that move are read again, each in its time

    def follow(self, message: Message, needed_ns: float) -> None:
        """Take a message's poses. needed_ns: none is needed for a time before it. Raises InputError if it has none."""
        value, is_fixed = message.value, message.topic.rpartition("/")[2] == STATIC
        try:
            for one in getattr(value, "transforms", [value]) if self._is_tree else [value]:
                ns = math.inf if is_fixed else float(self._when(Message(message.topic, message.log_ns, one)))
                name, parent = getattr(one, "child_frame_id", ""), ""
                if self._is_tree:
                    name, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
                elif self._links and name not in self._links:
                    came = ", ".join((*self._links, name))
                    raise self._stream.missing("child", "a frame of the transforms, and its parent", came)
                if name not in self._links or self._links[name].parent != parent:
                    self._links[name] = _Link(parent)
                self._links[name].add(ns, one, min(needed_ns, ns - 2e9 * self._stream.pose_age_s))
        except AttributeError as error:
            raise self._wrong(error) from error

    def _wrong(self, error: Exception) -> InputError:
        came = f"{self._type}: {' '.join(str(error).split())[:160]}"
        return self._stream.missing("pose", "a topic of poses or transforms", came)

    def _up(self, name: str) -> dict[str, list[_Link]]:
        """The frames above one, and the links that lead to each."""
        found: dict[str, list[_Link]] = {name: []}
        while name in self._links and (above := self._links[name].parent) not in found:
            found[above] = [*found[name], self._links[name]]
            name = above
        return found

    def _chain(self) -> tuple[list[_Link], list[_Link]] | None:
        """Links from a frame above both to the child, and to the parent, upwards; None if there is none."""
        if not self._is_tree:
            links = [one for one in self._links.values() if one.times]
            return (links, []) if links else None
        child, parent = self._up(self._child), self._up(self._parent)
        joint = next((name for name in child if name in parent), self._child)
        return None if joint == self._child else (child[joint], parent[joint])

    def newest_ns(self) -> float:
        """The time until which poses are known [ns]; minus infinity without any."""
        return -math.inf if (found := self._chain()) is None else min(one.times[-1] for one in found[0] + found[1])

    def at(self, ns: int) -> Pose | None:
        """The pose at a time, between those before and after it; None if they are more than `pose_age_s` away."""
        if (found := self._chain()) is None:
            return None
        T: list[Pose] = [np.eye(4), np.eye(4)]
        for at, links in enumerate(found):
            for one in links:
                try:
                    T_parent_frame, apart_ns = one.at(ns)
                except (AttributeError, ValueError) as error:
                    raise self._wrong(error) from error
                if apart_ns > self._stream.pose_age_s * 1e9:
                    return None
                T[at] = T_parent_frame @ T[at]
        return np.linalg.inv(T[1]) @ T[0] if found[1] else T[0]
