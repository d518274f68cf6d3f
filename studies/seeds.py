"""Seeds on which constants of the estimators are chosen, and seeds that are reported: never the same.

Committed before any constant was chosen on the former. A constant that is chosen on simulated scenes names this module
in its docstring."""

from deformscope.errors import InputError

REPORTED = range(1000)
"""Seeds that users' commands draw by default, and that figures in the documentation come from."""

TUNING = range(1000, 2000)
"""Seeds that constants are chosen on, and that no reported figure uses."""

INDEPENDENT = range(2000, 3000)
"""Seeds of generators that share no code with the estimators (`studies.independent`), drawn once: no constant was
chosen on them."""


def independent(count: int, first: int = 0) -> range:
    """`count` of these seeds, from the `first` of them on. Raises InputError if there are not enough."""
    return range(INDEPENDENT.start + (seeds := reported(count, first)).start, INDEPENDENT.start + seeds.stop)


def reported(count: int, first: int = 0) -> range:
    """`count` reported seeds from `first` on. Raises InputError where they would run into those for tuning."""
    seeds = range(first, first + count)
    if count < 1 or first < REPORTED.start or (first < TUNING.stop and seeds.stop > TUNING.start):
        expected = f"seeds from {REPORTED.start} to {REPORTED.stop - 1}, or from {TUNING.stop} on"
        raise InputError(expected, f"{count} from {first}", "the next ones are reserved for choosing constants")
    return seeds
