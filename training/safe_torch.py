"""Safe reader for files of torch.save: nothing is executed, and nothing is made that is larger than the file.

Such a file is a zip file with the bytes of each storage, and a pickle that describes what is made of them. torch.load
with weights_only executes nothing either, but it trusts lengths, and calls functions to which a file may pass absurd
numbers. Here the pickle is interpreted as a list of instructions, of which only those that torch.save needs are known,
and the only things that it can name are tensors and dicts.
"""

import io
import math
import pickletools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from outlast.envs.storage import safe_npz

KINDS = {
    "torch FloatStorage": torch.float32,
    "torch DoubleStorage": torch.float64,
    "torch LongStorage": torch.int64,
    "torch IntStorage": torch.int32,
    "torch ByteStorage": torch.uint8,
}
TENSOR, DICT = "torch._utils _rebuild_tensor_v2", "collections OrderedDict"
BROKEN = (*safe_npz.BROKEN, IndexError)
# Bounds, far above what torch.save writes for a run: instructions (two million take a minute and 200 MB), the lengths
# that a tensor has, and whole numbers.
INSTRUCTIONS, DIMENSIONS, LARGEST = 2**18, 8, 2**63


class Name(str):
    """A name in a pickle: one of KINDS, TENSOR or DICT."""


class Mark:
    """Where a list of values begins on the stack."""


def load_tensors(content: bytes) -> Any:
    """Read a file of torch.save: dicts, lists, tuples, numbers, texts, and CPU tensors that may share memory.

    Raises one of BROKEN for anything else.
    """
    files = safe_npz.entries(io.BytesIO(content))
    root = next(iter(files), "").partition("/")[0]
    if files.get(f"{root}/byteorder", b"little") != b"little":
        raise ValueError("tensors of a machine with another order of bytes")
    return _Machine(files, root).run(files[f"{root}/data.pkl"])


class _Machine:
    """Follows the instructions of a pickle, with its stack and its memo."""

    def __init__(self, files: dict[str, bytes], root: str) -> None:
        self.files, self.root = files, root
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.storages: dict[str, Tensor] = {}

    def run(self, code: bytes) -> Any:
        for number, (instruction, argument, _) in enumerate(pickletools.genops(code)):
            if number == INSTRUCTIONS:
                raise ValueError(f"more than {INSTRUCTIONS} instructions")
            if isinstance(argument, int) and abs(argument) >= LARGEST:
                raise ValueError("a number of more than 63 bits")
            if instruction.name == "STOP":
                return self.stack[-1]
            if instruction.name not in KNOWN:
                raise ValueError(f"the instruction {instruction.name}, which tensors do not need")
            KNOWN[instruction.name](self, argument)
        raise ValueError("no end")

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def last(self, count: int) -> list[Any]:
        """Take `count` values from the stack."""
        if count > len(self.stack):
            raise IndexError("too few values")
        start = len(self.stack) - count
        taken = self.stack[start:]
        del self.stack[start:]
        return taken

    def marked(self) -> list[Any]:
        """Take the values above the last mark, and the mark."""
        count = 0
        while not isinstance(self.stack[-1 - count], Mark):
            count += 1
        return self.last(count + 1)[1:]

    def name(self, name: str) -> None:
        if name not in (*KINDS, TENSOR, DICT):
            raise ValueError(f"the name {name:.80}, which tensors do not need")
        self.push(Name(name))

    def extend(self, values: list[Any]) -> None:
        if not isinstance(self.stack[-1], list):
            raise TypeError("values for what is no list")
        self.stack[-1].extend(values)

    def update(self, pairs: list[Any]) -> None:
        if not isinstance(self.stack[-1], dict) or not all(isinstance(key, (str, int)) for key in pairs[::2]):
            raise TypeError("keys for what is no dict, or of no use as such")
        self.stack[-1].update(zip(pairs[::2], pairs[1::2], strict=True))

    def call(self) -> None:
        """Call a name with arguments: it makes a tensor, or an empty dict. A dict's attributes are left out."""
        name, arguments = self.last(2)
        if not isinstance(name, Name) or not isinstance(arguments, tuple) or name not in (TENSOR, DICT):
            raise TypeError("a call that tensors do not need")
        self.push(_tensor(*arguments[:4]) if name == TENSOR else {})

    def storage(self) -> None:
        """Push the numbers of one storage, all in a row; there must be as many as it says."""
        ((word, kind, key, _, count),) = self.last(1)
        if word != "storage" or kind not in KINDS or not isinstance(key, str) or type(count) is not int:
            raise TypeError("a storage that is none")
        content = self.files[f"{self.root}/data/{key}"]
        if key not in self.storages:
            self.storages[key] = torch.frombuffer(bytearray(content or 8), dtype=KINDS[kind])
        found = self.storages[key][: count if content else 0]
        if found.dtype != KINDS[kind] or count * found.itemsize != len(content):
            raise ValueError(f"a storage of {count} numbers in {len(content)} bytes")
        self.push(found)


def _tensor(storage: Any, offset: Any, size: Any, stride: Any) -> Tensor:
    """A tensor over the numbers of a storage, with no more elements than that has.

    Nothing is computed, nor printed, before all is known to be whole numbers, and few.
    """
    if not isinstance(storage, Tensor) or not all(isinstance(each, tuple) for each in (size, stride)):
        raise TypeError("a tensor that is none")
    if len(size) != len(stride) or len(size) > DIMENSIONS:
        raise ValueError(f"a tensor of {len(size)} sizes and {len(stride)} strides")
    if not all(type(number) is int and number >= 0 for number in (*size, *stride, offset)):
        raise TypeError("a tensor whose size, strides and offset are not whole numbers")
    last = offset + sum((count - 1) * step for count, step in zip(size, stride, strict=True))
    if math.prod(size) > len(storage) or (math.prod(size) and last >= len(storage)):
        raise ValueError(f"a tensor of size {size}, out of bounds of its {len(storage)} numbers")
    return torch.as_strided(storage, size, stride, offset)


Step = Callable[[_Machine, Any], Any]
PUSHES = ("BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")
KNOWN: dict[str, Step] = {
    "PROTO": lambda machine, _: None,
    "MARK": lambda machine, _: machine.push(Mark()),
    **dict.fromkeys(PUSHES, _Machine.push),
    "NONE": lambda machine, _: machine.push(None),
    "NEWTRUE": lambda machine, _: machine.push(True),
    "NEWFALSE": lambda machine, _: machine.push(False),
    "EMPTY_DICT": lambda machine, _: machine.push({}),
    "EMPTY_LIST": lambda machine, _: machine.push([]),
    "EMPTY_TUPLE": lambda machine, _: machine.push(()),
    "TUPLE": lambda machine, _: machine.push(tuple(machine.marked())),
    "TUPLE1": lambda machine, _: machine.push(tuple(machine.last(1))),
    "TUPLE2": lambda machine, _: machine.push(tuple(machine.last(2))),
    "TUPLE3": lambda machine, _: machine.push(tuple(machine.last(3))),
    "APPEND": lambda machine, _: machine.extend(machine.last(1)),
    "APPENDS": lambda machine, _: machine.extend(machine.marked()),
    "SETITEM": lambda machine, _: machine.update(machine.last(2)),
    "SETITEMS": lambda machine, _: machine.update(machine.marked()),
    "GLOBAL": _Machine.name,
    "REDUCE": lambda machine, _: machine.call(),
    "BUILD": lambda machine, _: machine.last(1),
    "BINPERSID": lambda machine, _: machine.storage(),
    **dict.fromkeys(("BINPUT", "LONG_BINPUT"), lambda machine, key: machine.memo.update({key: machine.stack[-1]})),
    **dict.fromkeys(("BINGET", "LONG_BINGET"), lambda machine, key: machine.push(machine.memo[key])),
}
