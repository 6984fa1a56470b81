"""Evaluate constraints of a sweep, such as ``probe.gap < 0.1 * probe.inner_radius``; units are checked."""

from __future__ import annotations

import ast
import operator
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.errors import InputError
from geometry.scenes.units import base_unit, measured

Read = Callable[[str], tuple[Any, str]]  # key -> its SI values in all designs, and their SI unit
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
_SHOWN = ("m", "Pa", "N", "N/m", "rad", "m^2", "m^3", "C/N")
# characters; nodes from the root of the syntax tree to its leaves, so that recursion is safe
LONGEST, DEEPEST = 1000, 100


def satisfied(text: str, read: Read, count: int) -> NDArray[np.bool_]:
    """Return which designs satisfy a condition.

    Args:
        text: the condition. Quantities are quoted: ``'2 mm'``.
        read: returns the values of a key in all designs, a scalar or shape (count,), and their SI unit.
        count: number of designs.

    Returns:
        Booleans, shape (count,).

    Raises:
        InputError: the text is not a condition, names an unknown key, compares or adds different units, or is not finite for
            some design.
    """
    tree = _parsed(text)
    if not isinstance(tree, ast.Compare | ast.BoolOp | ast.UnaryOp):
        raise InputError("constraints", text, _ALLOWED)
    with np.errstate(all="ignore"):  # values that are not finite are refused later
        truth = _Condition(text, read).truth(tree)
    return np.broadcast_to(np.asarray(truth, dtype=bool), (count,))


def _parsed(text: str) -> ast.expr | None:
    """Parse a condition into Python's syntax tree; return None if the text is no expression.

    Raises:
        InputError: the text is too long, or its tree is too deep to be walked recursively.
    """
    if len(text) > LONGEST:
        raise InputError("constraints", text, f"conditions of at most {LONGEST} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Python accepts "1if" with a warning: refuse it
            tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    level: list[ast.AST] = [tree]
    for _ in range(DEEPEST):
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    if level:
        raise InputError("constraints", text, f"conditions nested at most {DEEPEST} deep")
    return tree


@dataclass(frozen=True)
class _Number:
    """Values and their SI base unit (pint); the unit is None for a bare 0, which fits every unit."""

    value: Any
    unit: Any


class _Condition:
    """Evaluate one condition node by node. Only the node types named here are evaluated, so that no other code can run."""

    def __init__(self, text: str, read: Read) -> None:
        self._text, self._read = text, read

    def truth(self, node: ast.expr) -> Any:
        """Evaluate a comparison or a logical expression in all designs."""
        if isinstance(node, ast.BoolOp):
            join = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
            return join.reduce([np.broadcast_arrays(*map(self.truth, node.values))], axis=1)[0]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return np.logical_not(self.truth(node.operand))
        if isinstance(node, ast.Compare) and all(type(one) in _COMPARISONS for one in node.ops):
            sides = [(side, self.number(side)) for side in (node.left, *node.comparators)]
            held: Any = True
            for compare, left, right in zip(node.ops, sides, sides[1:], strict=False):
                self._check_units(left, right)
                held = np.logical_and(held, _COMPARISONS[type(compare)](left[1].value, right[1].value))
            return held
        raise self._refused()

    def number(self, node: ast.expr) -> _Number:
        """Evaluate an arithmetic expression in all designs; refuse values that are not finite."""
        result = self._number(node)
        if not np.all(np.isfinite(result.value)):
            raise InputError("constraints", self._text, "a condition whose sides are finite for every design")
        return result

    def _number(self, node: ast.expr) -> _Number:
        """Evaluate an arithmetic node: a number, a quoted quantity, a key or an operation."""
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            return self._bare(node.value)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return self._quantity(node.value)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            operand = self.number(node.operand)
            return _Number(-operand.value, operand.unit)
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            return self._computed(node)
        if isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
            values, unit = self._read(ast.unparse(node))
            return _Number(np.asarray(values, dtype=float), base_unit(unit))
        raise self._refused()

    def _bare(self, value: float) -> _Number:
        """Return a number without unit; 0 fits every unit."""
        if abs(value) > sys.float_info.max:
            raise InputError("constraints", self._text, "finite numbers")
        return _Number(np.float64(value), base_unit("") if value else None)

    def _computed(self, node: ast.BinOp) -> _Number:
        """Evaluate an arithmetic operation with the unit of its result."""
        left, right = self.number(node.left), self.number(node.right)
        value = _ARITHMETIC[type(node.op)](left.value, right.value)
        if isinstance(node.op, ast.Add | ast.Sub):
            self._check_units((node.left, left), (node.right, right))
            return _Number(value, left.unit if right.unit is None else right.unit)
        one, other = (base_unit("") if side.unit is None else side.unit for side in (left, right))
        if isinstance(node.op, ast.Mult):
            return _Number(value, one * other)
        if isinstance(node.op, ast.Div):
            return _Number(value, one / other)
        if other != base_unit("") or (np.ndim(right.value) and one != base_unit("")):
            raise InputError("constraints", self._text, "exponents without a unit; plain numbers such as 2 if the base has one")
        return _Number(value, one if one == base_unit("") else one ** float(right.value))

    def _check_units(self, *sides: tuple[ast.expr, _Number]) -> None:
        """Refuse two sides that have different units (``InputError``)."""
        units = [side.unit for _, side in sides if side.unit is not None]
        if len(units) < 2 or units[0] == units[1]:
            return
        described = " and ".join(f"{ast.unparse(node)} ({_in_words(side.unit)})" for node, side in sides)
        remedy = "; quantities are written with their unit, in quotes: '2 mm'" if base_unit("") in units else ""
        raise InputError("constraints", self._text, f"sides of one unit, not {described}{remedy}")

    def _quantity(self, text: str) -> _Number:
        """Read a quoted quantity such as '2 mm'."""
        try:
            return _Number(*measured(text))
        except ValueError as fault:
            raise InputError("constraints", self._text, f"quantities such as '2 mm' ({fault})") from None

    def _refused(self) -> InputError:
        return InputError("constraints", self._text, _ALLOWED)


def _in_words(unit: Any) -> str:
    """Describe a unit for a message."""
    if unit is None or unit == base_unit(""):
        return "without a unit"
    return f"in {next((name for name in _SHOWN if base_unit(name) == unit), str(unit))}"
