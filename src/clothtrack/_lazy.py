"""Lazy imports for the `__init__.py` of a package (PEP 562).

A package lists its imports once, under `if TYPE_CHECKING:`, for editors and type checkers. This
module reads the same list at run time and imports each name on first use, so that
`import clothtrack` loads nothing heavy.
"""

import sys
from collections.abc import Callable
from functools import cache


def lazy_names(front: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return the `__getattr__` and `__dir__` of a package."""

    def get(name: str) -> object:
        from importlib import import_module

        try:
            module, original = _imports_of(front)[name]
        except KeyError:
            raise AttributeError(f"module {front!r} has no attribute {name!r}") from None
        found = getattr(import_module(module), original)
        setattr(sys.modules[front], name, found)
        return found

    return get, lambda: sorted(sys.modules[front].__all__)


@cache
def _imports_of(front: str) -> dict[str, tuple[str, str]]:
    """Return, per name imported for type checkers, its module and its name in that module."""
    import ast
    from pkgutil import get_data

    tree = ast.parse(get_data(front, "__init__.py") or b"")
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return {
        alias.asname or alias.name: (statement.module or "", alias.name)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
