"""A fixed-width vector for Numba: one lane is one robot.

All robots of a call share their topology, so the same instruction can move 8 (float64) or 16 (float32) of them.
Plain inner loops over the lanes do not vectorise: LLVM's alias checks cost more than the loop. A value of `Lanes`
is an LLVM vector instead, so a step written once in scalar notation is compiled for any width.

Memory is an array of rows, ``(n_rows, width)``, lanes contiguous: `load` and `store` move one row. The width and
precision travel as the *type* of the array, through its tag:

    tag = lanes(np.float32, 16)            # in Python
    x = load(tag, array, i)                # in a kernel: row i
    store(tag, array, i, x + tag_scalar)

Without Numba (``NUMBA_DISABLE_JIT=1``) the same kernels run on rows of NumPy arrays: the readable twin of every
method. No operation here mixes lanes except `any_lane`, which only decides whether work can be left out, so a
lane's bits do not depend on its neighbours, its place or the width.

No fast-math anywhere: reassociation, contraction to fused multiply-adds at the compiler's will or the assumption that
nothing is NaN would make the bits depend on the processor or blind the search for diverged robots. A fused
multiply-add that is asked for, `fma`, has one result everywhere: IEEE 754 defines it.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typing import templates
from numba.extending import NativeValue, lower_builtin, models, register_model, typeof_impl, unbox
from numpy.typing import NDArray

AbstractTemplate, signature = templates.AbstractTemplate, templates.signature
infer_global: Any = templates.infer_global
_IR = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}
_BYTES = {types.float32: 4, types.float64: 8}


# --- the tag: width and precision as a type -------------------------------------------------------------------


@dataclass(frozen=True)
class LanesTag:
    """Width and precision of the lanes: pass it to a kernel and to every `load`, `store` and `splat`."""

    dtype: np.dtype[Any]
    width: int


def lanes(dtype: Any, width: int) -> LanesTag:
    """Tag of `width` lanes of `dtype` (float32 or float64)."""
    return LanesTag(np.dtype(dtype), int(width))


class TagType(types.Type):
    """Numba type of a `LanesTag`; carries no data."""

    def __init__(self, dtype: types.Float, width: int):
        self.dtype, self.width = dtype, width
        super().__init__(name=f"LanesTag({dtype}x{width})")


class LanesType(types.Type):
    """Numba type of a vector of `width` numbers."""

    def __init__(self, dtype: types.Float, width: int):
        self.dtype, self.width = dtype, width
        super().__init__(name=f"Lanes({dtype}x{width})")


class MaskType(types.Type):
    """Numba type of a vector of `width` truth values."""

    def __init__(self, width: int):
        self.width = width
        super().__init__(name=f"Mask({width})")


register_model(TagType)(models.OpaqueModel)


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: LanesType):
        super().__init__(dmm, fe_type, ir.VectorType(_IR[fe_type.dtype], fe_type.width))


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: MaskType):
        super().__init__(dmm, fe_type, ir.VectorType(ir.IntType(1), fe_type.width))


@typeof_impl.register(LanesTag)
def _typeof_tag(value: LanesTag, context: Any) -> TagType:
    return TagType(types.float32 if value.dtype == np.float32 else types.float64, value.width)


@unbox(TagType)
def _unbox_tag(typ: TagType, obj: Any, c: Any) -> NativeValue:
    return NativeValue(c.context.get_dummy_value())


# --- memory ---------------------------------------------------------------------------------------------------


def load(tag: Any, array: Any, i: int) -> Any:
    """Row i of a ``(n_rows, width)`` array."""
    return array[i].copy()


def store(tag: Any, array: Any, i: int, value: Any) -> None:
    """Write row i of a ``(n_rows, width)`` array."""
    array[i] = value


def splat(tag: Any, value: Any) -> Any:
    """The same number in every lane."""
    return np.full(tag.width, value, tag.dtype)


def _row_pointer(context: Any, builder: Any, array_type: Any, array: Any, i: Any, vector: Any, width: int) -> Any:
    """Address of row i: the rows are contiguous, so the stride is known when the kernel is compiled."""
    struct = context.make_array(array_type)(context, builder, array)
    item = builder.gep(struct.data, [builder.mul(i, ir.Constant(i.type, width))])
    return builder.bitcast(item, vector.as_pointer())


def _check_rows(array: Any, lanes_type: LanesType) -> None:
    if not (isinstance(array, types.Array) and array.ndim == 2 and array.layout == "C"):
        raise TypeError(f"lanes need a contiguous (rows, width) array, not {array}")
    if array.dtype != lanes_type.dtype:
        raise TypeError(f"lanes of {lanes_type.dtype} cannot be rows of {array.dtype}")


def _inline(function: Any, kinds: tuple[Any, ...], typing: Any, codegen: Any) -> None:
    """Teach Numba a function whose code is emitted in place: `typing(*args)` gives (result, argument types).

    An `@overload` would cost a call for every row: Numba's wrappers are too large for LLVM to inline reliably.
    """

    @infer_global(function)
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) != len(kinds) or not (kinds[0] is types.Any or isinstance(args[0], kinds[0])):
                return None
            result, arguments = typing(*args)
            return signature(result, *arguments)

    lower_builtin(function, *kinds)(codegen)


def _pointer_in(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    tag, array = sig.args[:2]
    vector = ir.VectorType(_IR[tag.dtype], tag.width)
    return _row_pointer(context, builder, array, args[1], args[2], vector, tag.width)


def _type_row(tag: TagType, array: Any, i: Any, *value: Any) -> Any:
    vector = LanesType(tag.dtype, tag.width)
    _check_rows(array, vector)
    return (types.none if value else vector), (tag, array, types.intp, *([vector] * len(value)))


def _lower_load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.load(_pointer_in(context, builder, sig, args), align=_BYTES[sig.args[0].dtype])


def _lower_store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    builder.store(args[3], _pointer_in(context, builder, sig, args), align=_BYTES[sig.args[0].dtype])
    return context.get_dummy_value()


def _splat_value(builder: Any, scalar: Any, width: int) -> Any:
    vector = ir.VectorType(scalar.type, width)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


_inline(load, (TagType, types.Array, types.Integer), _type_row, _lower_load)
_inline(store, (TagType, types.Array, types.Integer, LanesType), _type_row, _lower_store)
_inline(
    splat,
    (TagType, types.Number),
    lambda tag, value: (LanesType(tag.dtype, tag.width), (tag, tag.dtype)),
    lambda context, builder, sig, args: _splat_value(builder, args[1], sig.args[0].width),
)


# --- arithmetic -----------------------------------------------------------------------------------------------


@lower_cast(types.Float, LanesType)
@lower_cast(types.Integer, LanesType)
def _cast_scalar(context: Any, builder: Any, fromty: Any, toty: LanesType, value: Any) -> Any:
    return _splat_value(builder, context.cast(builder, value, fromty, toty.dtype), toty.width)


def _common(args: tuple[Any, ...]) -> LanesType | None:
    """The lanes type of an operation between lanes and at most one scalar, which takes the lanes' precision."""
    vectors = {a for a in args if isinstance(a, LanesType)}
    scalars = [a for a in args if not isinstance(a, LanesType)]
    if len(vectors) == 1 and all(isinstance(a, types.Number) for a in scalars):
        return vectors.pop()
    return None


def _binary(operation: Any, method: str, *predicate: str) -> None:
    """Teach Numba one operator: lanes with lanes, or with a scalar on either side."""

    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            vector = _common(args) if len(args) == 2 else None
            if vector is None:
                return None
            return signature(MaskType(vector.width) if predicate else vector, vector, vector)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, method)(*predicate, *args)

    lower_builtin(operation, LanesType, LanesType)(lower)


_binary(operator.add, "fadd")
_binary(operator.sub, "fsub")
_binary(operator.mul, "fmul")
_binary(operator.truediv, "fdiv")
# Comparisons are ordered: false as soon as one side is NaN, as in Python.
_binary(operator.lt, "fcmp_ordered", "<")
_binary(operator.le, "fcmp_ordered", "<=")
_binary(operator.gt, "fcmp_ordered", ">")
_binary(operator.ge, "fcmp_ordered", ">=")


def _unary(operation: Any, kind: type[types.Type], lower: Any) -> None:
    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(args[0], args[0]) if len(args) == 1 and isinstance(args[0], kind) else None

    lower_builtin(operation, kind)(lambda context, builder, sig, args: lower(builder, args[0]))


def _call(builder: Any, name: str, *values: Any) -> Any:
    """Emit a call of LLVM's intrinsic function of that name."""
    vector = values[0].type
    suffix = {"float": "f32", "double": "f64"}[str(vector.element)]
    kind = ir.FunctionType(vector, [vector] * len(values))
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{vector.count}{suffix}")
    return builder.call(function, values)


def _intrinsic_call(name: str) -> Any:
    return lambda builder, value: _call(builder, name, value)


_unary(operator.neg, LanesType, lambda builder, value: builder.fneg(value))
_unary(abs, LanesType, _intrinsic_call("fabs"))
_unary(operator.invert, MaskType, lambda builder, value: builder.not_(value))


def _mask_binary(operation: Any, method: str) -> None:
    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            same = len(args) == 2 and isinstance(args[0], MaskType) and args[0] == args[1]
            return signature(args[0], *args) if same else None

    lower_builtin(operation, MaskType, MaskType)(lambda context, builder, sig, args: getattr(builder, method)(*args))


_mask_binary(operator.and_, "and_")
_mask_binary(operator.or_, "or_")


# --- functions ------------------------------------------------------------------------------------------------


def square_root(value: Any) -> Any:
    """Correctly rounded square root of each lane."""
    return np.sqrt(value)


def fma(a: Any, b: Any, c: Any) -> Any:
    """The sum a b + c with one rounding, of each lane; scalars stand for lanes that are all alike.

    One instruction on processors since 2013; on older ones a slow library call, with the same bits.
    """
    dtype = next(value.dtype for value in (a, b, c) if isinstance(value, np.ndarray))
    a, b, c = (np.asarray(value, dtype).astype(np.float64) for value in (a, b, c))
    with np.errstate(all="ignore"):
        if dtype == np.float32:  # a product of two of them is exact in float64
            return _sum_to_odd(a * b, c).astype(dtype)
        return _fma_in_pieces(a, b, c)


def _two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """The rounded sum and its error (Knuth 1969)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _sum_to_odd(a: Any, b: Any) -> Any:
    """Sum rounded to the neighbour with an odd last bit: rounding that again, to fewer bits, is rounding once."""
    total, error = _two_sum(a, b)
    bits = total.view(np.int64)
    inexact = np.isfinite(error) & (error != 0) & (bits & 1 == 0)
    away = np.where((error > 0) == (total > 0), 1, -1)
    return np.where(inexact, bits + away, bits).view(np.float64)


def _fma_in_pieces(a: Any, b: Any, c: Any) -> Any:
    """The same in float64, from exact pieces (Boldo & Melquiond 2008), for numbers far from the ends of the range."""
    product = a * b
    a_high, b_high = (x * 134217729.0 - (x * 134217729.0 - x) for x in (a, b))  # 2^27 + 1 (Dekker 1971)
    a_low, b_low = a - a_high, b - b_high
    rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    high, low = _two_sum(c, rest)
    total, error = _two_sum(product, high)
    return np.where(np.isfinite(rest) & np.isfinite(error), total + _sum_to_odd(error, low), product + c)


def select(mask: Any, yes: Any, no: Any) -> Any:
    """`yes` where the mask holds, `no` elsewhere; each may be a scalar if the other is not."""
    other = yes if isinstance(yes, np.ndarray) else no
    return np.where(mask, yes, no).astype(other.dtype)


def smaller(a: Any, b: Any) -> Any:
    """The smaller of two; `b` where either is NaN."""
    return select(a < b, a, b)


def larger(a: Any, b: Any) -> Any:
    """The larger of two; `b` where either is NaN."""
    return select(a > b, a, b)


def any_lane(mask: Any) -> bool:
    """Whether the mask holds in any lane. Use it only to leave work out, never to choose a result."""
    return bool(np.any(mask))


def _type_select(mask: MaskType, yes: Any, no: Any) -> Any:
    vector = _common((yes, no))
    if vector is None:
        raise TypeError(f"select needs lanes on one side at least, not {yes} and {no}")
    return vector, (mask, vector, vector)


def _type_order(a: Any, b: Any) -> Any:
    return a, (a, a)


def _lower_any(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    bits = builder.bitcast(args[0], ir.IntType(sig.args[0].width))
    return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))


def _lower_order(predicate: str) -> Any:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(predicate, *args), *args)

    return lower


def _type_fma(a: Any, b: Any, c: Any) -> Any:
    vector = _common((a, b, c))
    if vector is None:
        raise TypeError(f"fma needs lanes of one kind, not {a}, {b} and {c}")
    return vector, (vector, vector, vector)


_unary(square_root, LanesType, _intrinsic_call("sqrt"))
_inline(
    fma, (types.Any, types.Any, types.Any), _type_fma,
    lambda context, builder, sig, args: _call(builder, "fma", *args),
)  # fmt: skip
_inline(
    select, (MaskType, types.Any, types.Any), _type_select,
    lambda context, builder, sig, args: builder.select(*args),
)  # fmt: skip
_inline(smaller, (LanesType, LanesType), _type_order, _lower_order("<"))
_inline(larger, (LanesType, LanesType), _type_order, _lower_order(">"))
_inline(any_lane, (MaskType,), lambda mask: (types.boolean, (mask,)), _lower_any)


# --- allocation -----------------------------------------------------------------------------------------------


def aligned_zeros(n_rows: int, tag: LanesTag) -> NDArray[Any]:
    """Zeros of shape (n_rows, width) whose rows begin on cache lines: a row that crosses one costs twice."""
    line = 64
    count = n_rows * tag.width * tag.dtype.itemsize
    raw = np.zeros(count + line, np.uint8)
    start = -raw.ctypes.data % line
    return raw[start : start + count].view(tag.dtype).reshape(n_rows, tag.width)
