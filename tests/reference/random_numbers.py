"""The random numbers of a tick by numpy's own Philox, computed independently of the engine."""

import hashlib
import math

import numpy as np

from tests.helpers.naive_world import NaiveEntity, World


def name_hash(name: str) -> int:
    """The number of a stream or a kind: eight bytes of its blake2b hash."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")


def draw_index(entity: NaiveEntity) -> int:
    """The index of an entity's draws: its kind in the upper 31 bits, its number in the lower 32."""
    return (name_hash(entity.kind) >> 33 << 32) + entity.index


def philox(world: World, stream: str, index: int) -> list[int]:
    """Four uint64: Philox4x64-10 of (seed, world) as key and (episode, tick, stream, index) as counter."""
    return keyed(world.key, world.tick, stream, index)


def keyed(key: tuple[int, int, int], tick: int, stream: str, index: int) -> list[int]:
    """The same by (seed, world, episode)."""
    seed, number, episode = key
    counter = episode + (tick << 64) + (name_hash(stream) << 128) + (index << 192)
    generator = np.random.Philox(counter=(counter - 1) % 2**256, key=seed + (number << 64))  # it counts before it draws
    return [int(word) for word in generator.random_raw(4)]


def uniform2(world: World, stream: str, index: int) -> tuple[float, float]:
    """Two numbers in [0, 1), of 24 bits each."""
    first, second, *_ = philox(world, stream, index)
    return (first >> 40) / 2**24, (second >> 40) / 2**24


def scattered(world: World, item: NaiveEntity, agent: NaiveEntity) -> tuple[float, float]:
    """Where an item of a dead agent falls: on a circle around it, or anywhere inside."""
    direction, area = uniform2(world, "drop.scatter", draw_index(item))
    share = math.sqrt(area) if world.numbers["death_drop_scatter"] == "disc" else 1.0
    radius, angle = world.numbers["death_drop_radius"] * share, 2 * math.pi * direction
    return agent.x + radius * math.cos(angle), agent.y + radius * math.sin(angle)
