"""Which effects blind trials hide."""

from blind import world


def test_effects_take_turns():
    plans = [world.plan(seed, "default")[0] for seed in range(1000, 1100)]
    ones = [p[0] for p in plans if len(p) == 1 and p[0] in world.CATALOGUE]
    assert set(ones) == set(world.CATALOGUE)
    assert max(ones.count(n) for n in world.CATALOGUE) - min(ones.count(n) for n in world.CATALOGUE) <= 1
    assert sum(p == () for p in plans) == 15
    assert not any(world.plan(seed, "nulls")[0] for seed in range(40))


def test_clear_pairs_are_of_effects_that_no_stiffness_takes_up():
    clear = [world.plan(seed, "clear")[0] for seed in range(1000, 1200)]
    assert {len(set(pair)) for pair in clear} == {2}
    assert {name for pair in clear for name in pair} == set(world.CATALOGUE) - {*world.TAKEN_UP, *world.BRISK}


def test_strong_effects_are_all_of_the_catalogue():
    strong = [world.plan(seed, "strong")[0] for seed in range(7001, 7001 + len(world.CATALOGUE))]
    assert sorted(strong) == sorted((name,) for name in world.CATALOGUE)
