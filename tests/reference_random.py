"""The random numbers of a tick by numpy's own Philox: what chance decides, computed apart from the engine."""

import hashlib
import math

import numpy as np

from tests.naive_world import Thing, World


def number_of(name: str) -> int:
    """Of a stream or a kind: eight bytes of blake2b."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


def identity(thing: Thing) -> int:
    """The index of a thing's draws: its kind in the upper 31 bits, its number in the lower 32."""
    return (number_of(thing.kind) >> 33 << 32) + thing.index


def words(world: World, stream: str, index: int) -> list[int]:
    """Four uint64: Philox4x64-10 of (seed, world) as key and (episode, tick, stream, index) as counter."""
    seed, number, episode = world.key
    counter = episode + (world.tick << 64) + (number_of(stream) << 128) + (index << 192)
    generator = np.random.Philox(counter=(counter - 1) % 2**256, key=seed + (number << 64))  # it counts before it draws
    return [int(word) for word in generator.random_raw(4)]


def uniform2(world: World, stream: str, index: int) -> tuple[float, float]:
    """Two numbers in [0, 1), of 24 bits each."""
    first, second, *_ = words(world, stream, index)
    return (first >> 40) / 2**24, (second >> 40) / 2**24


def scattered(world: World, item: Thing, agent: Thing) -> tuple[float, float]:
    """Where an item of a dead agent falls: on the rim of a circle around it, or anywhere inside."""
    direction, far = uniform2(world, "drop.scatter", identity(item))
    share = math.sqrt(far) if world.numbers["death_drop_scatter"] == "disc" else 1.0
    reach, turn = world.numbers["death_drop_radius"] * share, 2 * math.pi * direction
    return agent.x + reach * math.cos(turn), agent.y + reach * math.sin(turn)
