"""Conditions between the variables of a sweep, such as ``probe.gap < 0.1 * probe.inner_radius``."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import InputError
from geometry.units import Quantity

Read = Callable[[str], Any]  # a key's values in all designs, SI
_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}  # fmt: skip
_ALLOWED = (
    "a condition such as 'probe.gap < 0.1 * probe.inner_radius': keys, numbers, '2 mm', + - * / **, < <= > >= == !=, and, or, not"
)
_UNITS = ("m", "Pa", "N", "rad", "C/N")
LONGEST = 1000


def kept(text: str, read: Read, count: int) -> NDArray[np.bool_]:
    """Say which of ``count`` designs meet a condition.

    Args:
        text: the condition; quantities in it in quotes, ``'2 mm'``.
        read: gives the values of a key in all designs, one number or shape (count,), SI.
        count: how many designs there are.

    Returns:
        Shape (count,).

    Raises:
        InputError: it is no condition, names an unknown key, or is not finite for some design.
    """
    try:
        tree = ast.parse(text, mode="eval").body if len(text) <= LONGEST else None
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        tree = None
    if not isinstance(tree, ast.Compare | ast.BoolOp | ast.UnaryOp):
        raise InputError("constraints", text, _ALLOWED)
    with np.errstate(all="ignore"):  # what is not finite is refused below
        found = _Condition(text, read).truth(tree)
    return np.broadcast_to(np.asarray(found, dtype=bool), (count,))


class _Condition:
    """The walk over one condition: nothing but the nodes named here is ever computed."""

    def __init__(self, text: str, read: Read) -> None:
        self._text, self._read = text, read

    def truth(self, node: ast.expr) -> Any:
        if isinstance(node, ast.BoolOp):
            join = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
            return join.reduce([np.broadcast_arrays(*map(self.truth, node.values))], axis=1)[0]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return np.logical_not(self.truth(node.operand))
        if isinstance(node, ast.Compare) and all(type(one) in _COMPARISONS for one in node.ops):
            sides = [self.number(side) for side in (node.left, *node.comparators)]
            held: Any = True
            for compare, left, right in zip(node.ops, sides, sides[1:], strict=False):
                held = np.logical_and(held, _COMPARISONS[type(compare)](left, right))
            return held
        raise self._refused()

    def number(self, node: ast.expr) -> Any:
        value = self._number(node)
        if not np.all(np.isfinite(value)):
            raise InputError("constraints", self._text, "a condition whose sides are finite for every design")
        return value

    def _number(self, node: ast.expr) -> Any:
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            return np.float64(node.value)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return self._quantity(node.value)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -self.number(node.operand)
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            return _ARITHMETIC[type(node.op)](self.number(node.left), self.number(node.right))
        if isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
            return np.asarray(self._read(ast.unparse(node)), dtype=float)
        raise self._refused()

    def _quantity(self, text: str) -> Any:
        for unit in _UNITS:
            try:
                return np.float64(Quantity("quantity", unit, unit, -1e300, 1e300).parse(text))
            except ValueError:
                continue
        raise InputError("constraints", self._text, f"quantities with a unit of {', '.join(_UNITS)}, not {text!r}")

    def _refused(self) -> InputError:
        return InputError("constraints", self._text, _ALLOWED)
