"""What differs between two results by more than other processors' arithmetic makes of it."""

from collections.abc import Collection

import numpy as np

from deformscope.rows import to_components


def differing_by_more(
    before: object, now: object, leave_out: Collection[str] = (), *, share: float = 1e-6
) -> str | None:
    """As `rows.differing`, but for numbers that differ by less than this share of the largest beside them."""
    first, second = to_components(before, leave_out), to_components(now, leave_out)
    for name in sorted((first.keys() | second.keys()) - set(leave_out)):
        one, other = first.get(name), second.get(name)
        if one is None or other is None or one.shape != other.shape:
            return name
        if one.dtype.kind == "f":
            scale = float(np.nanmax(np.abs(one), initial=0.0))
            if not np.allclose(one, other, rtol=0.0, atol=share * scale, equal_nan=True):
                return name
        elif not np.array_equal(one, other):
            return name
    return None
