"""The names of a front, imported when somebody first asks for them (PEP 562).

A front lists its imports once, under `if TYPE_CHECKING:`, where editors and type checkers read
them. Here the same list is read at run time, so that `import clothtrack` loads nothing heavy.
"""

import sys
from collections.abc import Callable
from functools import cache


def lazy_names(front: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a package.

    Args:
        front: name of the package; its `__init__.py` has the imports under `if TYPE_CHECKING:` and
            their names in `__all__`.
    """

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
    """Module and name there of every name that a front imports for type checkers."""
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
