"""The cores and the memory that a process may use."""

import os
from pathlib import Path

import pytest

from outlast.ecs.kernels import available
from outlast.ecs.kernels.available import available_cores, available_memory

MIB = 2**20
FREE = "MemTotal: 9000000 kB\nMemAvailable: 4096000 kB\n"  # 4,000 MiB
OUTER = f"cache 1\nactive_file {10 * MIB}\ninactive_file 0\n"

HOSTS: dict[str, tuple[str, dict[str, str], int, int]] = {  # the process's group, files, cores of 8, MiB
    "no limits": ("0::/a", {"a/cpu.max": "max 100000", "a/memory.max": "max"}, 8, 4000),
    "a group in a group": ("0::/a/b", {
        "a/cpu.max": "250000 100000", "a/b/cpu.max": "400000 100000",
        "a/memory.max": str(100 * MIB), "a/memory.current": str(70 * MIB), "a/memory.stat": OUTER,
    }, 3, 40),
    "a container's own view": ("0::/", {"cpu.max": "20000 100000"}, 1, 4000),
    "a container that sees the host's names": ("0::/docker/1", {"cpu.max": "200000 100000"}, 2, 4000),
    "version 1": ("4:cpu,memory:/a", {"a/cpu.cfs_quota_us": "200000", "a/cpu.cfs_period_us": "100000"}, 8, 4000),
    "more memory used than allowed": ("0::/", {"memory.max": "5", "memory.current": "7", "cpu.max": "?"}, 8, 0),
}  # fmt: skip


@pytest.mark.parametrize("host", HOSTS)
def test_control_groups_limit_cores_and_memory(host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    group, files, cores, memory = HOSTS[host]
    monkeypatch.setattr(available, "PROC", tmp_path)
    monkeypatch.setattr(available, "GROUPS", tmp_path / "groups")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    (tmp_path / "self").mkdir()
    (tmp_path / "meminfo").write_text(FREE)
    (tmp_path / "self" / "cgroup").write_text(f"1:cpuset:/other\n{group}\n")
    for name, text in files.items():
        path = tmp_path / "groups" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert (available_cores(), available_memory() / MIB) == (cores, memory)


def test_without_control_groups_the_machine_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(available, "PROC", tmp_path)
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert available_cores() == os.cpu_count()
    assert available_memory() == float("inf")
