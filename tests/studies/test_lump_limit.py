"""How many lumps could be distinguished from foam that scatters at all."""

from studies.lump_limit import limit

SEED = 1000


def test_foam_that_scatters_more_hides_more_and_exponents_show_it() -> None:
    even, rough = limit(0.002, lumps=3, seed=SEED), limit(0.2, lumps=3, seed=SEED, exponent=False)
    assert even > 0.999
    assert rough < 0.98 * even
    assert limit(0.2, lumps=3, seed=SEED) > rough
