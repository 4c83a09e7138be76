"""Dual numbers for compiled code: exact derivatives of any kernel, from the source that computes its value.

A dual number is a value and its partial derivatives with respect to `WIDTH` parameters. A kernel called with duals
instead of numbers is compiled once more, by the same rules, and carries the partials through every operation
(forward-mode automatic differentiation; Griewank and Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, section 3.1).
An equation is therefore written once, and its derivative always agrees with it. The value of a dual has the same bits
as the plain number; only the partials are computed with relaxed floating-point rules, which lets the compiler drop
those that are always zero.

Instead of an array of numbers, a kernel can take a `dual_array` with the same syntax inside: parameters with their
seeds (row k is 1 in the column of parameter k), a state, or an output.
"""

from functools import update_wrapper
from typing import Any

from friction_hil.numerics.jit import OPTIONS, Deferred, once_compiling

WIDTH = 7  # nonlinear parameters of LuGre with directions in identification; more parameters take several runs

types: Any = Deferred("numba.types")
cgutils: Any = Deferred("numba.core.cgutils")
ir: Any = Deferred("llvmlite.ir")
arrayobj: Any = Deferred("numba.np.arrayobj")
# numba's types of duals and of arrays of them; what is defined there, compiled code has
dual_types: Any = Deferred("friction_hil.numerics.dual_types")


class Intrinsic:
    """An operation of compiled code, stated in the instructions of LLVM; see `numba.extending.intrinsic`."""

    def __init__(self, define: Any) -> None:
        update_wrapper(self, define)
        self._define = define
        once_compiling(self._register)

    def __call__(self, *_: Any) -> Any:
        """Raise an error: Python has no such operation."""
        raise NotImplementedError(f"{self._define.__name__} exists in compiled code only")

    def _register(self) -> None:
        from numba.core.typing.templates import builtin_registry
        from numba.extending import intrinsic, typeof_impl

        own = intrinsic(self._define)
        self.kind = next(kind for value, kind in reversed(builtin_registry.globals) if value is own)
        typeof_impl.register(Intrinsic)(lambda one, _: one.kind)


def intrinsic(define: Any) -> Any:
    """Decorate the definition of an operation: from the types of its arguments, its signature and its code."""
    return Intrinsic(define)


def overloaded(function: Any) -> Any:
    """Decorate an implementation of ``function`` for compiled code that depends on the types of its arguments."""

    def take(implementation: Any) -> Any:
        def register() -> None:
            from numba.extending import overload

            overload(function, jit_options=OPTIONS, strict=False)(implementation)

        once_compiling(register)
        return implementation

    return take


def forwarded(function: Any) -> Any:
    """Decorate what chooses, from the type of the first argument, the kernel that compiled code calls for ``function``.

    It returns the kernel and the index of the first argument to pass on: a function that only forwards would be
    compiled with all that it calls.
    """

    def take(choose: Any) -> Any:
        def resolved(typing: Any, args: Any) -> tuple[Any, Any, int]:
            kernel, first = choose(args[0])
            target = types.Dispatcher(kernel.dispatcher)
            return target, target.get_call_type(typing, args[first:], {}), first

        def register() -> None:
            from numba.core.typing.templates import AbstractTemplate, infer_global, signature
            from numba.extending import lower_builtin

            def generic(self: Any, args: Any, _: Any) -> Any:
                _, chosen, first = resolved(self.context, args)
                return signature(chosen.return_type, *args[:first], *chosen.args)

            def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
                target, chosen, first = resolved(context.typing_context, sig.args)
                return context.get_function(target, chosen)(builder, args[first:])

            infer_global(function)(type("_Forwarded", (AbstractTemplate,), {"generic": generic}))
            lower_builtin(function, types.VarArg(types.Any))(lower)

        once_compiling(register)
        return choose

    return take


@intrinsic
def primal(_: Any, x: Any) -> Any:
    """Return the value of a number without its partials."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return dual_types.unpack(context, builder, sig.args[0], args[0])[0]

    return types.float64(x), generate


@intrinsic
def chain(_: Any, value: Any, slope: Any, x: Any) -> Any:
    """Return a function's dual: its ``value``, and its ``slope`` times the partials of the argument ``x``."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, partials = dual_types.unpack(context, builder, dual_types.DUAL, args[2])
        assert partials is not None
        return dual_types.pack(context, builder, args[0], [dual_types.scaled(builder, d, args[1]) for d in partials])

    return dual_types.DUAL(types.float64, types.float64, dual_types.DUAL), generate


@intrinsic
def fma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute x y + z with a single rounding."""
    return types.float64(types.float64, types.float64, types.float64), lambda c, builder, s, args: builder.fma(*args)


@intrinsic
def borrowed(_: Any, array: Any, begin: Any) -> Any:
    """Return a view of a contiguous array from an index of its first dimension on, without a reference to the array.

    The caller must keep the array alive. Numba counts the references of slices with atomic operations, which would take
    longer than a whole step of a model. A view of an array inside a structured array has the same type as any other, so
    that kernels are compiled once for both.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        source = context.make_array(sig.args[0])(context, builder, value=args[0])
        view = context.make_array(sig.return_type)(context, builder)
        shape, strides = (cgutils.unpack_tuple(builder, each) for each in (source.shape, source.strides))
        start = builder.mul(args[1], strides[0])
        arrayobj.populate_array(
            view,
            data=cgutils.pointer_add(builder, source.data, start),
            shape=[builder.sub(shape[0], args[1]), *shape[1:]],
            strides=strides,
            itemsize=source.itemsize,
            meminfo=None,
        )
        return view._getvalue()

    return types.Array(array.dtype, array.ndim, "C")(array, types.int64), generate


@intrinsic
def borrowed_at(_: Any, address: Any, length: Any) -> Any:
    """Return a view of ``length`` numbers at an address: as an argument, a number is cheaper than an array."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        view = context.make_array(dual_types.VECTOR)(context, builder)
        size = ir.Constant(dual_types.I8, 8)
        data = builder.inttoptr(args[0], view.data.type)
        arrayobj.populate_array(view, data=data, shape=[args[1]], strides=[size], itemsize=size, meminfo=None)
        return view._getvalue()

    return dual_types.VECTOR(types.int64, types.int64), generate


def differentiable(function: Any, value_of: Any, slope_of: Any) -> None:
    """Let compiled code call ``function``, which kernels call, with one number or dual.

    ``value_of``: compiled, x -> f(x). ``slope_of``: compiled, x, f(x) -> df/dx.
    """

    @overloaded(function)
    def choose(x: Any) -> Any:
        if isinstance(x, dual_types.DualType):

            def of_dual(x):  # type: ignore[no-untyped-def]
                plain = primal(x)
                value = value_of(plain)
                return chain(value, slope_of(plain, value), x)

            return of_dual
        return lambda x: value_of(x)


@intrinsic
def dual_array(_: Any, values: Any, partials: Any) -> Any:
    """Return an array of duals, made of two arrays of numbers: values (n,) and partials (n, WIDTH)."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pair = cgutils.create_struct_proxy(dual_types.DUAL_ARRAY)(context, builder)
        for (name, kind), member in zip(dual_types.MEMBERS, args, strict=True):
            setattr(pair, name, member)
            context.nrt.incref(builder, kind, member)
        return pair._getvalue()

    return dual_types.DUAL_ARRAY(dual_types.VECTOR, dual_types.TABLE), generate


once_compiling(lambda: dual_types.define())
