"""Protection zones that the arm's own firmware keeps its hand out of, also after this program has died.

Zones are stored in the arm, and apply to any program or joystick that moves it later. Published facts: a zone is a
prism on a base with four corners, and one whose speed is 0 is not entered. Cartesian motions respect them, motions by
joints as this driver sends them do not (kinova-ros issue 386). This was not tested on a real arm."""

from collections.abc import Callable, Sequence

from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.jaco.config import Workspace
from deformscope_drivers.jaco.library import Functions, call, read
from deformscope_drivers.jaco.structures import ShapeType, Zone, ZoneList

WITHIN_M = 1e-5
"""Tolerance of corners that are read back: they travel in single precision."""


def zone_list(boxes: Sequence[Workspace]) -> ZoneList:
    """The vendor's structure of boxes that the hand may not enter."""
    zones = ZoneList()
    zones.NbZones = len(boxes)
    for index, (box, zone) in enumerate(zip(boxes, zones.Zones, strict=False)):
        (x0, y0, z0), (x1, y1, z1) = box.low_m, box.high_m
        zone.ID, zone.zoneShape.shapeType = index + 1, ShapeType.PRISM_SQUARE_BASE_Z
        for corner, (x, y) in enumerate(((x0, y0), (x0, y1), (x1, y1), (x1, y0))):
            for point, z in ((zone.zoneShape.Points[corner], z0), (zone.zoneShape.Points[corner + 4], z1)):
                point.X, point.Y, point.Z = x, y, z
    return zones


def boxes_of(zones: ZoneList) -> tuple[Workspace, ...]:
    """The boxes around zones that the hand may not enter; zones that only limit its speed are left out."""
    found = []
    for zone in zones.Zones[: zones.NbZones]:
        base, top = zone.zoneShape.Points[:4], zone.zoneShape.Points[4]
        xs, ys = [point.X for point in base], [point.Y for point in base]
        low_m, high_m = (min(xs), min(ys), min(base[0].Z, top.Z)), (max(xs), max(ys), max(base[0].Z, top.Z))
        if zone.zoneLimitation.speedParameter1 == 0.0 and all(a < b for a, b in zip(low_m, high_m, strict=True)):
            found.append(Workspace(low_m, high_m))
    return tuple(found)


def set_zones(functions: Functions, boxes: Sequence[Workspace], pause: Callable[[], None]) -> None:
    """Have the arm keep exactly these, and read them back. If the arm has them already, nothing is written. pause:
    waits between two writes to the arm's configuration. Raises SettingsRefused where it says otherwise after."""
    if _alike(boxes, read(functions, "GetProtectionZone", ZoneList)):
        return
    call(functions, "EraseAllProtectionZones")
    pause()
    if boxes:
        call(functions, "SetProtectionZone", zone_list(boxes))
        pause()
    stored = read(functions, "GetProtectionZone", ZoneList)
    if not _alike(boxes, stored):
        expected, came = f"an arm that stores {len(boxes)} protection zones", f"{len(_closed(stored))}, or others"
        advice = "check them in Kinova's Development Center; or leave protection_zones out of the rig file"
        raise SettingsRefused(expected, f"one that reports {came}", advice, functions.where)


def _closed(zones: ZoneList) -> list[Zone]:
    return [zone for zone in zones.Zones[: zones.NbZones] if zone.zoneLimitation.speedParameter1 == 0.0]


def _alike(boxes: Sequence[Workspace], zones: ZoneList) -> bool:
    """Whether the arm excludes these zones and no others, in any order."""
    left = _closed(zones)
    for box in boxes:
        same = next((number for number, zone in enumerate(left) if _is(box, zone)), None)
        if same is None:
            return False
        left.pop(same)
    return not left


def _is(box: Workspace, zone: Zone) -> bool:
    """Whether a zone is this box: a prism with its four corners, from whichever and whichever way round they are named.
    One that lies turned within the box keeps the hand out of less."""
    points = zone.zoneShape.Points
    (x0, y0, z0), (x1, y1, z1) = box.low_m, box.high_m
    corners = ((x0, y0), (x0, y1), (x1, y1), (x1, y0))
    low_z, top_z = sorted((points[0].Z, points[4].Z))
    upright = zone.zoneShape.shapeType == ShapeType.PRISM_SQUARE_BASE_Z and _near((low_z, top_z), (z0, z1))
    return upright and any(
        all(
            _near((point.X, point.Y, point.Z), (*corners[(first + way * number) % 4], points[0].Z))
            for number, point in enumerate(points[:4])
        )
        for first in range(4)
        for way in (1, -1)
    )


def _near(ones: Sequence[float], others: Sequence[float]) -> bool:
    return all(abs(one - other) <= WITHIN_M for one, other in zip(ones, others, strict=True))
