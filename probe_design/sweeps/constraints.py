"""Evaluate constraints of a sweep, such as ``probe.gap < 0.1 * probe.inner_radius``; units are checked."""

from __future__ import annotations

import ast
import operator
import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.errors import InputError
from geometry.scenes.units import find_base_unit, parse_measured

Measured = Any  # a quantity of pint, whose values are one number or an array over the designs
ReadKey = Callable[[str], tuple[Any, str]]  # key -> its SI values in all designs, and their SI unit
_ARITHMETIC_FUNCTIONS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
_COMPARISON_FUNCTIONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}  # fmt: skip
_ALLOWED_FORM = (
    "a condition such as 'probe.gap < 0.1 * probe.inner_radius': keys, numbers, '2 mm', + - * / **, < <= > >= == !=, and, or, not"
)
_PRINTED_UNITS = ("m", "Pa", "N", "N/m", "rad", "m^2", "m^3", "C/N")
# characters; nodes from the root of the syntax tree to its leaves, so that recursion is safe
MAX_CONDITION_CHARACTERS, MAX_TREE_DEPTH = 1000, 100


def evaluate_condition(text: str, read: ReadKey, count: int) -> NDArray[np.bool_]:
    """Return which designs satisfy a condition.

    Parameters
    ----------
    text
        The condition. Quantities are quoted: ``'2 mm'``.
    read
        Returns the values of a key in all designs, a scalar or shape (count,), and their SI unit.
    count
        Number of designs.

    Returns
    -------
    NDArray[np.bool_]
        Booleans, shape (count,).

    Raises
    ------
    InputError
        The text is not a condition, names an unknown key, compares or adds different units, or is not finite for some design.
    """
    tree = _parse_condition(text)
    if not isinstance(tree, ast.Compare | ast.BoolOp | ast.UnaryOp):
        raise InputError("constraints", text, _ALLOWED_FORM)
    with np.errstate(all="ignore"):  # values that are not finite are refused later
        truth = _Condition(text, read).evaluate_truth(tree)
    return np.broadcast_to(np.asarray(truth, dtype=bool), (count,))


def _parse_condition(text: str) -> ast.expr | None:
    """Parse a condition into Python's syntax tree; return None if the text is no expression.

    Raises
    ------
    InputError
        The text is too long, or its tree is too deep to be walked recursively.
    """
    if len(text) > MAX_CONDITION_CHARACTERS:
        raise InputError("constraints", text, f"conditions of at most {MAX_CONDITION_CHARACTERS} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Python accepts "1if" with a warning: refuse it
            tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    nodes: list[ast.AST] = [tree]
    for _ in range(MAX_TREE_DEPTH):
        nodes = [child for node in nodes for child in ast.iter_child_nodes(node)]
    if nodes:
        raise InputError("constraints", text, f"conditions nested at most {MAX_TREE_DEPTH} deep")
    return tree


class _Condition:
    """Evaluate one condition node by node. Only the node types named here are evaluated, so that no other code can run.

    All quantities are in SI base units. A number 0 without a unit fits every unit.
    """

    def __init__(self, text: str, read: ReadKey) -> None:
        """Prepare to evaluate ``text``; ``read`` is that of ``evaluate_condition``."""
        self._text, self._read = text, read

    def evaluate_truth(self, node: ast.expr) -> Any:
        """Evaluate a comparison or a logical expression in all designs."""
        if isinstance(node, ast.BoolOp):
            # reduce over the operands, which broadcast_arrays brings to one shape
            join = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
            return join.reduce([np.broadcast_arrays(*map(self.evaluate_truth, node.values))], axis=1)[0]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return np.logical_not(self.evaluate_truth(node.operand))
        if isinstance(node, ast.Compare) and all(type(operation) in _COMPARISON_FUNCTIONS for operation in node.ops):
            sides = [(side, self.evaluate_number(side)) for side in (node.left, *node.comparators)]
            holds: Any = True
            for compare, left, right in zip(node.ops, sides, sides[1:], strict=False):
                self._check_units(left, right)
                holds = np.logical_and(holds, _COMPARISON_FUNCTIONS[type(compare)](left[1].magnitude, right[1].magnitude))
            return holds
        raise self._build_refusal()

    def evaluate_number(self, node: ast.expr) -> Measured:
        """Evaluate an arithmetic expression in all designs; refuse values that are not finite."""
        result = self._evaluate_node(node)
        if not np.all(np.isfinite(result.magnitude)):
            raise InputError("constraints", self._text, "a condition whose sides are finite for every design")
        return result

    def _evaluate_node(self, node: ast.expr) -> Measured:
        """Evaluate an arithmetic node: a number, a quoted quantity, a key or an operation."""
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            if abs(node.value) > sys.float_info.max:
                raise InputError("constraints", self._text, "finite numbers")
            return np.float64(node.value) * find_base_unit("")
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            try:
                value, unit = parse_measured(node.value)
            except ValueError as fault:
                raise InputError("constraints", self._text, f"quantities such as '2 mm' ({fault})") from None
            return np.float64(value) * unit
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -self.evaluate_number(node.operand)
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC_FUNCTIONS:
            return self._evaluate_arithmetic(node)
        if isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
            values, unit_name = self._read(ast.unparse(node))
            return np.asarray(values, dtype=float) * find_base_unit(unit_name)
        raise self._build_refusal()

    def _evaluate_arithmetic(self, node: ast.BinOp) -> Measured:
        """Evaluate an arithmetic operation with the unit of its result."""
        left, right = self.evaluate_number(node.left), self.evaluate_number(node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            self._check_units((node.left, left), (node.right, right))
            unit = right.units if _is_bare_zero(left) else left.units
            return _ARITHMETIC_FUNCTIONS[type(node.op)](left.magnitude, right.magnitude) * unit
        if isinstance(node.op, ast.Pow):
            if not _has_no_unit(right) or (np.ndim(right.magnitude) and not _has_no_unit(left)):
                allowed = "exponents without a unit; plain numbers such as 2 if the base has one"
                raise InputError("constraints", self._text, allowed)
            unit = left.units if _has_no_unit(left) else left.units ** float(right.magnitude)
            return left.magnitude**right.magnitude * unit
        return _ARITHMETIC_FUNCTIONS[type(node.op)](left, right)

    def _check_units(self, *sides: tuple[ast.expr, Measured]) -> None:
        """Raise ``InputError`` if two sides, each a node with its value, have different units."""
        units = [value.units for _, value in sides if not _is_bare_zero(value)]  # a bare 0 fits every unit
        if len(units) < 2 or units[0] == units[1]:
            return
        description = " and ".join(f"{ast.unparse(node)} ({_describe_unit(value)})" for node, value in sides)
        remedy = "; quantities are written with their unit, in quotes: '2 mm'" if find_base_unit("") in units else ""
        raise InputError("constraints", self._text, f"sides of one unit, not {description}{remedy}")

    def _build_refusal(self) -> InputError:
        """Return the error for a text that is no condition."""
        return InputError("constraints", self._text, _ALLOWED_FORM)


def _has_no_unit(value: Measured) -> bool:
    """Return whether a value is a pure number."""
    return bool(value.units == find_base_unit(""))


def _is_bare_zero(value: Measured) -> bool:
    """Return whether a value is one number 0 without a unit, which fits every unit."""
    return _has_no_unit(value) and not np.ndim(value.magnitude) and value.magnitude == 0.0


def _describe_unit(value: Measured) -> str:
    """Describe the unit of a value for a message."""
    if _has_no_unit(value):
        return "without a unit"
    return f"in {next((name for name in _PRINTED_UNITS if find_base_unit(name) == value.units), str(value.units))}"
