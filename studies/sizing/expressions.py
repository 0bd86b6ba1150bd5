"""Expressions that a user writes, over figures and numbers by name: read, never executed.

An expression has numbers, names such as ``fuel``, ``city.distance_m`` or ``engine.torque_scale``, the operators ``+ - * / **`` with a
number as exponent, and the functions ``abs``, ``sqrt``, ``exp``, ``log``, ``min`` and ``max``.  It becomes a CasADi function, which has its
derivatives.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any

import casadi as ca
import numpy as np

from halfshaft.cosim.compiled import Array

#: Longest text, and deepest nesting.
LONGEST, DEEPEST = 2000, 50
LARGEST = 1e300
OPERATORS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
#: Functions of one number, and of several.
ONE = {"abs": ca.fabs, "sqrt": ca.sqrt, "exp": ca.exp, "log": ca.log}
SEVERAL = {"min": ca.fmin, "max": ca.fmax}
ALLOWED = f"+ - * / **, {', '.join((*ONE, *SEVERAL))}, numbers and names"


@dataclass(frozen=True)
class Expression:
    """An expression, and the names in it, in the order in which they first stand."""

    text: str
    names: tuple[str, ...]
    _tree: Any = field(repr=False, compare=False)

    @property
    def plain(self) -> bool:
        """Whether it is a single name."""
        return self.names == (self.text,)

    @cached_property
    def _function(self) -> ca.Function:
        x = ca.SX.sym("x", len(self.names))
        value = ca.SX(_built(self._tree, {name: x[i] for i, name in enumerate(self.names)}))
        return ca.Function("expression", [x], [value, ca.jacobian(value, x)])

    def __call__(self, values: Array) -> tuple[Array, Array]:
        """Return the value and its gradient for the values of its names, a row for each name; NaN goes through."""
        value, gradient = self._function(np.asarray(values, dtype=float))
        return np.asarray(value).ravel(), np.asarray(gradient).reshape(len(np.atleast_1d(np.asarray(value).ravel())), -1)


def read_expression(text: str) -> Expression:
    """Return what a text says.

    Raises
    ------
    ValueError
        If it is no expression.

    """
    if len(text) > LONGEST:
        raise ValueError(f"is longer than {LONGEST} characters")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        names: dict[str, None] = {}
        _check(tree, names, 0)
    except (SyntaxError, ValueError, MemoryError, RecursionError) as e:
        said = str(e) if type(e) is ValueError and str(e).startswith("has") else "is no expression"
        raise ValueError(f"{said}, must be made of {ALLOWED}") from None
    return Expression(text.strip(), tuple(names), tree)


def _check(node: ast.AST, names: dict[str, None], depth: int) -> None:
    """Note the names, and raise an error at anything that an expression does not have."""
    if depth > DEEPEST:
        raise ValueError("has too many levels")
    if (x := _number(node)) is not None and abs(x) < LARGEST:
        return
    if (name := _name(node)) is not None:
        names.setdefault(name)
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        if isinstance(node.op, ast.Pow) and _number(node.right) is None:
            raise ValueError("has an exponent that is no number")
        _check(node.left, names, depth + 1)
        _check(node.right, names, depth + 1)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        _check(node.operand, names, depth + 1)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        count, what = len(node.args), node.func.id
        if not ((what in ONE and count == 1) or (what in SEVERAL and count > 1)):
            raise ValueError(f"has {ast.unparse(node)[:40]}")
        for argument in node.args:
            _check(argument, names, depth + 1)
    else:
        raise ValueError(f"has {ast.unparse(node)[:40]}")


def _name(node: ast.AST) -> str | None:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (owner := _name(node.value)) is not None:
        return f"{owner}.{node.attr}"
    return None


def _number(node: ast.AST) -> float | None:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return None if (x := _number(node.operand)) is None else -x
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    return None


def _built(node: Any, symbols: Mapping[str, Any]) -> Any:
    if (name := _name(node)) is not None:
        return symbols[name]
    if isinstance(node, ast.Constant):
        return _number(node)
    if isinstance(node, ast.BinOp):
        right = _number(node.right) if isinstance(node.op, ast.Pow) else _built(node.right, symbols)
        return OPERATORS[type(node.op)](_built(node.left, symbols), right)
    if isinstance(node, ast.UnaryOp):
        x = _built(node.operand, symbols)
        return -x if isinstance(node.op, ast.USub) else x
    arguments = [_built(x, symbols) for x in node.args]
    return ONE[node.func.id](arguments[0]) if node.func.id in ONE else reduce(SEVERAL[node.func.id], arguments)
