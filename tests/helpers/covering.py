"""Combinations of options as parameters of tests: by day so many that each pair of options is there."""

import itertools
from collections.abc import Iterable
from typing import Any

import pytest


def covering(*options: Iterable[Any]) -> list[Any]:
    """All combinations of one of each; nightly are those that add no pair of options to the ones before them."""

    def pairs(combination: tuple[int, ...]) -> set[tuple[tuple[int, int], ...]]:
        return {*itertools.combinations(enumerate(combination), 2)}

    values = [list(each) for each in options]
    every = [*itertools.product(*(range(len(each)) for each in values))]
    left, chosen = set().union(*map(pairs, every)), set()
    while left:
        best = max(every, key=lambda combination: len(pairs(combination) & left))
        chosen.add(best)
        left -= pairs(best)
    marks = [() if combination in chosen else (pytest.mark.nightly,) for combination in every]
    taken = [tuple(each[k] for each, k in zip(values, combination, strict=True)) for combination in every]
    return [pytest.param(*own, marks=mark) for own, mark in zip(taken, marks, strict=True)]
