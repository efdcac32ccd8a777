"""Numba's type of the arrays that units hand to outlast's own kernels: indices are used as they are.

Normally, numba checks whether an index is negative, and if so counts from the end. This costs a comparison and a
selection per access, a tenth of the time of a tick. An index of a `ColumnType` must be at least 0. A negative one that
is known at compile time is an error then; any other accesses the wrong memory, which only the plain-Python form
notices.

Systems from outside outlast get a `CheckedColumn`. Its indices are checked, also in kernels of outlast's that they
call, and those below 0 count from the end.

A float cannot be written to an integer column of either type, as numba would truncate it.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.datamodel import models, register_default
from numba.core.errors import NumbaIndexError, NumbaTypeError
from numba.core.imputils import lower_builtin
from numba.extending import overload_classmethod
from numba.np import arrayobj

from . import jit

CUT = "which cuts it off"


class _Column(types.Array):  # type: ignore[misc]
    word = ""  # that its name begins with
    layouts: tuple[str, ...] = ()  # in which its parts are columns, too

    def __init__(self, dtype: Any, ndim: int, layout: str = "C", readonly: bool = False, **more: Any) -> None:
        super().__init__(dtype, ndim, layout, readonly=readonly, **more)
        self.name: str = f"{self.word}{self.name}"

    @property
    def mangling_args(self) -> Any:
        """The parts of its name in symbols."""
        return f"{self.word}Column", super().mangling_args[1]

    def copy(self, dtype: Any = None, ndim: Any = None, layout: Any = None, readonly: Any = None) -> Any:
        """Return the type of a part of such an array, for example of a slice."""
        readonly = not self.mutable if readonly is None else readonly
        layout, ndim = layout or self.layout, self.ndim if ndim is None else ndim
        kind = type(self) if layout in self.layouts else types.Array
        return kind(dtype or self.dtype, ndim, layout, readonly=readonly)


class ColumnType(_Column):
    """An array in order of rows ("C") whose indices are not negative."""

    word, layouts = "Column", ("C",)
    unchecked = True  # intrinsics look for this, as their code may not refer to classes


class CheckedColumn(_Column):
    """The same for systems from outside outlast, with checked indices."""

    word, layouts = "Checked", ("A", "C", "F")


register_default(ColumnType)(models.ArrayModel)
register_default(CheckedColumn)(models.ArrayModel)


def _parts(builder: Any, index_kind: Any, index: Any) -> tuple[list[Any], list[Any]]:
    """Return types and values of an index's parts. NumbaIndexError for a negative constant among them."""
    if isinstance(index_kind, types.BaseTuple):
        kinds, parts = list(index_kind), [_element(builder, index, k) for k in range(len(index_kind))]
    else:
        kinds, parts = [index_kind], [index]
    for part in parts:
        if isinstance(part, ir.Constant) and isinstance(part.constant, int) and part.constant < 0:
            raise NumbaIndexError(f"the index {part.constant} of a column: count from the start")
    return kinds, parts


def _element(builder: Any, values: Any, k: int) -> Any:
    """Return element `k` of a tuple: if the code has just made the tuple, the value that it put there."""
    source = values
    while isinstance(source, ir.instructions.InsertValue):
        if list(source.indices) == [k]:
            return source.operands[1]
        source = source.operands[0]
    return builder.extract_value(values, k)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, kinds: Any, indices: Any) -> Any:
    model = context.data_model_manager[kind]
    data, shape = (builder.extract_value(array, model.get_field_position(name)) for name in ("data", "shape"))
    place = None
    for axis, (index_kind, index) in enumerate(zip(kinds, indices, strict=True)):
        index = context.cast(builder, index, index_kind, types.intp)
        place = index if place is None else builder.add(builder.mul(place, builder.extract_value(shape, axis)), index)
    return builder.gep(data, [place])


def _plain(kind: Any, kinds: list[Any]) -> bool:
    """Return whether an index with parts of these types selects one element of an array of the type `kind`."""
    return kind.layout == "C" and len(kinds) == kind.ndim and all(isinstance(each, types.Integer) for each in kinds)


@lower_builtin(operator.getitem, ColumnType, types.Integer)  # type: ignore[untyped-decorator]
@lower_builtin(operator.getitem, ColumnType, types.BaseTuple)  # type: ignore[untyped-decorator]
def _get(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, index_kind = signature.args
    kinds, indices = _parts(builder, index_kind, arguments[1])
    if _plain(kind, kinds):
        return context.unpack_value(builder, kind.dtype, _pointer(context, builder, kind, arguments[0], kinds, indices))
    if isinstance(index_kind, types.BaseTuple):
        return arrayobj.getitem_array_tuple(context, builder, signature, arguments)
    return arrayobj.getitem_arraynd_intp(context, builder, signature, arguments)


def _refuse_cut(kind: Any, value: Any) -> None:
    """Raise NumbaTypeError if numba would cut off the fraction of a written value of the type `value`."""
    value = value.dtype if isinstance(value, types.Array) else value
    if isinstance(kind.dtype, types.Integer) and isinstance(value, types.Float):
        raise NumbaTypeError(f"writes a float to a column of {kind.dtype}, {CUT}; say so, as in np.{kind.dtype}(...)")


@lower_builtin(operator.setitem, ColumnType, types.Integer, types.Any)  # type: ignore[untyped-decorator]
@lower_builtin(operator.setitem, ColumnType, types.BaseTuple, types.Any)  # type: ignore[untyped-decorator]
def _set(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, index_kind, value_kind = signature.args
    _refuse_cut(kind, value_kind)
    kinds, indices = _parts(builder, index_kind, arguments[1])
    if not _plain(kind, kinds):
        return arrayobj.setitem_array(context, builder, signature, arguments)
    value = context.cast(builder, arguments[2], value_kind, kind.dtype)
    context.pack_value(builder, kind.dtype, value, _pointer(context, builder, kind, arguments[0], kinds, indices))
    return context.get_dummy_value()


def _checked(lowering: Any) -> Any:
    """Return a lowering of numba's whose code checks indices, even in a function whose own options do not."""

    def lower(context: Any, *rest: Any) -> Any:
        return lowering(context.subtarget(enable_boundscheck=True) if jit.BOUNDS_CHECKS else context, *rest)

    return lower


for _index, _lowering in (
    (types.Integer, arrayobj.getitem_arraynd_intp),
    (types.BaseTuple, arrayobj.getitem_array_tuple),
    (types.Array, arrayobj.fancy_getitem_array),
):
    lower_builtin(operator.getitem, CheckedColumn, _index)(_checked(_lowering))

# To allocate what is gathered, copied or sorted, numba looks for this method in exactly the class of the type.
overload_classmethod(CheckedColumn, "_allocate", target="CPU")(arrayobj._ol_array_allocate)


@lower_builtin(operator.setitem, CheckedColumn, types.Any, types.Any)  # type: ignore[untyped-decorator]
def _set_checked(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    _refuse_cut(signature.args[0], signature.args[2])
    return _checked(arrayobj.setitem_array)(context, builder, signature, arguments)
