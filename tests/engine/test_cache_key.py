"""The key of the compile cache has what changes machine code, and nothing else."""

import enum
from collections import namedtuple
from types import ModuleType
from typing import Any, NamedTuple

import llvmlite.binding
import numba
import numpy as np
import pytest

from outlast.ecs import kernel
from outlast.ecs.compilation import cache_key
from outlast.ecs.compilation.cache_key import SETTINGS, CacheKey
from tests.conftest import COMPILED

pytestmark = pytest.mark.skipif(not COMPILED, reason="about machine code")
PRINTING: dict[str, dict[str, Any]] = {
    "numpy 1.25": {"legacy": "1.25"},
    "numpy 1.13": {"legacy": "1.13"},
    "few digits": {"precision": 1, "threshold": 1},
}


class Loud(int):
    def __repr__(self) -> str:
        return "Loud"


class Quiet(str):
    __slots__ = ()

    def __repr__(self) -> str:
        return "Quiet"


class Pair(NamedTuple):
    one: Any = np.float32(0.1)


def members(value: Any) -> type[enum.Enum]:
    return enum.Enum("Members", {"ONE": value})


def renamed(function: Any) -> Any:
    """A kernel of one name and place, whose parameters alone may have another order."""
    function.__code__ = function.__code__.replace(co_firstlineno=1, co_name="f", co_qualname="f")
    function.__name__ = function.__qualname__ = "f"
    return kernel(function)


CONSTANTS: list[tuple[Any, Any]] = [  # each two need machine code of their own
    (np.float32(0.1), np.float64(0.1)),
    (0.1, np.float64(0.1)),
    (0.1, np.nextafter(0.1, 1)),
    (1, 1.0),
    (1, True),
    (1, np.int64(1)),
    (np.int32(1), np.uint32(1)),
    (0.0, -0.0),
    (1.0, 1.0 + 0.0j),
    (Loud(1), Loud(2)),
    (Quiet("a"), Quiet("b")),
    ("a", b"a"),
    ((1, (2.0,)), (1, (np.float32(2.0),))),
    ([np.int8(1)], [np.int16(1)]),
    (slice(0, np.int32(9)), slice(0, np.int64(9))),
    (range(3), range(4)),
    (np.dtype("f4"), np.dtype("f8")),
    (np.array([0.1], "f4"), np.array([0.1], "f4").astype("f8")),
    (np.array([1, 2]), np.array([1, 3])),
    (np.arange(2e3), np.arange(2e3) + (np.arange(2e3) == 1e3)),
    (np.ones((2, 3)), np.ones((3, 2))),
    (np.ones((2, 3)), np.ones((2, 3), order="F")),
    (Pair(np.float32(0.1)), Pair(np.float64(0.1))),
    (members(np.float32(0.1)), members(np.float64(0.1))),
    (members(1).ONE, members(2).ONE),  # type: ignore[attr-defined]
    (numba.types.int32, numba.types.int64),
    (None, 0),
    (namedtuple("Range", "low high")(1.0, 2.0), namedtuple("Range", "high low")(1.0, 2.0)),
    (np.hamming, np.hanning),
    (renamed(lambda a, b: a - b), renamed(lambda b, a: b - a)),
]


def key_of(value: Any) -> str:
    """The key of a kernel that refers to this value."""
    names = {"VALUE": value}
    exec("def function(k):\n    return VALUE", names)
    return CacheKey({"system": kernel(names["function"])}).key("system", "source")


@pytest.mark.parametrize("pair", CONSTANTS)
def test_constants_of_another_type_or_other_bits_have_another_key(pair: tuple[Any, Any]) -> None:
    keys = [key_of(value) for value in pair]
    assert keys[0] != keys[1]
    for options in PRINTING.values():
        with np.printoptions(**options):
            assert [key_of(value) for value in pair] == keys


REFERENCES = {  # definitions of another file, and how a kernel refers to the number 1 there
    "a function": ("@kernel\ndef speed():\n    return 1", "rules.speed()"),
    "a member of a module": ("SPEED = 1", "rules.SPEED"),
    "a member of an enumeration": ("class Speed(IntEnum):\n    NOW = 1", "Speed.NOW.value"),
    "only a nested function refers to it": ("SPEED = 1", "(lambda: rules.SPEED)()"),
    "a part of a tuple": ("SPEED = (9, (1, 9))", "rules.SPEED[1][0]"),
    "a default of a parameter": ("SPEED = 1\n@kernel\ndef speed(value=SPEED):\n    return value", "speed()"),
    "a kernel that a kernel calls": (
        "SPEED = 1\n@kernel\ndef inner():\n    return SPEED\n@kernel\ndef speed():\n    return inner()", "speed()",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFERENCES)
def test_what_a_kernel_refers_to_in_another_file_is_in_its_key(kind: str) -> None:
    definitions, expression = REFERENCES[kind]
    keys = []
    for text in (definitions, f"{definitions}\nOTHER = 7", definitions.replace("1", "3")):
        rules = ModuleType("rules")
        vars(rules).update(kernel=kernel, IntEnum=enum.IntEnum)
        exec(text, vars(rules))
        exec(f"def function(k):\n    return {expression}", names := {**vars(rules), "rules": rules})
        keys += [CacheKey(dict.fromkeys(of, kernel(names["function"]))).key("s", "source") for of in ("s", "as")]
    assert keys[0] == keys[1] == keys[2] == keys[3] != keys[4] == keys[5]


# Settings of numba that change messages, threads, files, checks of numba itself, or graphics cards
TEXT = """
ALWAYS_WARN_UNINIT_VAR ANNOTATE CACHE_DIR CACHE_LOCATOR_CLASSES CHROME_TRACE COLOR_SCHEME DEBUG DEBUG_ARRAY_OPT
DEBUG_ARRAY_OPT_RUNTIME DEBUG_ARRAY_OPT_STATS DEBUG_CACHE DEBUG_FRONTEND DEBUG_INLINE_CLOSURE DEBUG_PRINT_AFTER
DEBUG_PRINT_BEFORE DEBUG_PRINT_WRAP DEBUG_TYPEINFER DEVELOPER_MODE DIFF_IR DISABLE_PERFORMANCE_WARNINGS
DISABLE_TYPEINFER_FAIL_CACHE DUMP_ASSEMBLY DUMP_BYTECODE DUMP_CFG DUMP_FUNC_OPT DUMP_IR DUMP_LLVM DUMP_OPTIMIZED
DUMP_SSA ENABLE_PROFILING ENABLE_SYS_MONITORING FULL_TRACEBACKS FUNCTION_CACHE_SIZE GDB_BINARY HIGHLIGHT_DUMPS HTML
JIT_COVERAGE LLVM_PASS_TIMINGS NUMBA_DEFAULT_NUM_THREADS NUMBA_NUM_THREADS PARALLEL_DIAGNOSTICS PARFOR_MAX_TUPLE_SIZE
RUNNING_UNDER_PROFILER SHOW_HELP THREADING_LAYER THREADING_LAYER_PRIORITY TRACE USE_LLVMLITE_MEMORY_MANAGER
DISABLE_CUDA ENABLE_CUDASIM FORCE_CUDA_CC
"""
IGNORED = TEXT.split()
# These act through what numba makes of them when it starts, which is in the key
INDIRECT = ["CPU_FEATURES", "CPU_NAME", "DISABLE_INTEL_SVML", "ENABLE_AVX"]
OTHERS = ["DISABLE_JIT", "IS_32BITS", "IS_OSX", "IS_WIN32", "MACHINE_BITS", "PYVERSION"]  # no code, or the platform
ABSENT = {"DEBUG_NRT_STACK_LIMIT", "USE_LEGACY_TYPE_SYSTEM"}  # from some versions of numba


def test_every_setting_of_numba_is_known() -> None:
    """One that a new version brings has to be looked up: does it change machine code?"""
    there = {name for name in vars(numba.config) if name.isupper() and not name.startswith(("CUDA_", "_"))}
    assert there <= {*SETTINGS, *IGNORED, *INDIRECT, *OTHERS}
    assert {*SETTINGS} - ABSENT <= there


@pytest.mark.parametrize("name", [*SETTINGS, *IGNORED])
def test_settings_that_change_machine_code_change_the_key(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = key_of(1)
    monkeypatch.setattr(numba.config, name, "another value", raising=False)
    assert (key_of(1) != before) == (name not in IGNORED)


@pytest.mark.parametrize("given", [None, "generic"])
def test_the_processor_is_the_one_that_code_is_made_for(given: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """By default the host's; NUMBA_CPU_NAME names another one, for which machines share code."""
    monkeypatch.setattr(numba.config, "CPU_NAME", given)
    keys = set()
    for host in ("skylake", "znver3"):
        monkeypatch.setattr(llvmlite.binding, "get_host_cpu_name", lambda: host)  # noqa: B023
        keys.add(key_of(1))
    assert len(keys) == (1 if given else 2)


def test_features_of_the_processor_change_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    before = key_of(1)
    monkeypatch.setattr(cache_key.cpu_target.target_context.codegen(), "_tm_features", "+avx2")
    assert key_of(1) != before
