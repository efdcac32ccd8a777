"""The cores and the memory that this process may use: affinity and control groups limit its share of a machine."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

PROC, GROUPS = Path("/proc"), Path("/sys/fs/cgroup")  # control groups of version 2


def available_cores() -> int:
    """Return the number of cores that this process may use, at least 1.

    Its affinity and the quotas of its control groups (containers, jobs of a cluster) count, rounded up to full cores.
    """
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [found for group in _control_groups() if len(found := _numbers(group / "cpu.max")) == 2]
    return max(1, min([allowed, *(math.ceil(quota / period) for quota, period in quotas)]))


def available_memory() -> float:
    """Return the number of bytes of free memory that this process can take; infinity if unknown."""
    words = _text(PROC / "meminfo").split()
    free = [int(words[words.index("MemAvailable:") + 1]) * 1024] if "MemAvailable:" in words else []
    for group in _control_groups():
        if len(found := _numbers(group / "memory.max") + _numbers(group / "memory.current")) == 2:
            words = _text(group / "memory.stat").split()
            cached = [int(words[words.index(name) + 1]) for name in ("active_file", "inactive_file") if name in words]
            free.append(found[0] - found[1] + sum(cached))  # cached files can be dropped
    return max(0, min([math.inf, *free]))


def _control_groups() -> Iterator[Path]:
    """Yield the folders of this process's control group and of its parents."""
    for line in _text(PROC / "self" / "cgroup").splitlines():
        if line.startswith("0::/"):
            group = GROUPS / line.removeprefix("0::/")
            yield from (each for each in (group, *group.parents) if each.is_relative_to(GROUPS))


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""


def _numbers(path: Path) -> list[int]:
    """Return the integers in a file; none if it has other text, such as "max"."""
    words = _text(path).split()
    return [int(word) for word in words] if all(word.isdecimal() for word in words) else []
