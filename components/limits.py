"""The largest numbers that scenarios can have; beyond them, something hangs, wraps or leaves the range of float32."""

MANY = 65_536  # rows of a kind: more would take gigabytes, or minutes to lay out
FAR = 100_000.0  # metres: float32 still tells apart places 8 mm from each other, and physics takes less than 1e6
FAST = 100_000.0  # metres or radians a second: physics takes less than 1e6
TICKS = 1_000_000_000  # a year; counts of ticks are int32, and sums of a few of these fit into int64
STRONG = 1e5  # impulses, frictions and dampings: products of a few stay far inside float32
LIGHT, HEAVY = 1e-3, 1e6  # kilograms per square metre: inverses of the masses of the smallest discs stay inside float32
MUCH = 1e9  # reward: sums over an episode stay finite
