"""The largest numbers that scenarios can have; beyond them, code hangs, wraps or leaves the range of float32."""

MANY = 65_536  # rows of a kind: more would take gigabytes, or minutes to lay out
CROWD = 4096  # agents: each observes all others, so memory grows with the square of their number
FAR = 10_000.0  # metres: in a room of this size, float32 still separates positions half a millimetre apart
FAST = 100_000.0  # metres or radians a second: more than Box2D lets a body move in a substep
TICKS = 1_000_000_000  # a year; counts of ticks are int32, and sums of a few of these fit into int64
STRONG = 1e5  # impulses, frictions and dampings: products of a few stay far inside float32
LIGHT, HEAVY = 1e-3, 1e6  # kilograms per square metre: inverses of the masses of the smallest discs stay inside float32
MUCH = 1e9  # reward: sums over an episode stay finite
