"""The source files of a package as modules: what each defines, imports, and does while it is imported."""

from __future__ import annotations

import ast
import pathlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TypeAlias, TypeGuard

Import = ast.Import | ast.ImportFrom
Function = ast.FunctionDef | ast.AsyncFunctionDef
#: What import statements bind: by name, the modules, or the attributes of modules.
Imports: TypeAlias = dict[str, list[tuple[str, str | None]]]
#: What a name stands for; a definition with the one of its names that it was found under.
Meaning: TypeAlias = "tuple[str, Definition] | Module | External"


class CodeError(LookupError):
    """A path names a module or definition that is not there."""


@dataclass(frozen=True, eq=False)
class Definition:
    """Top-level statements of a module."""

    module: Module
    statements: tuple[ast.stmt, ...]
    names: tuple[str, ...]
    """What they bind; nothing, if they are what the module does while being imported."""


@dataclass(frozen=True)
class External:
    """Something of another distribution, by its dotted name."""

    name: str


class Sources:
    """A package's source files, read once."""

    def __init__(self, root: pathlib.Path, package: str) -> None:
        """Read the package as it stands in the folder ``root``."""
        self.root, self.package = root, package
        self._modules: dict[str, Module | None] = {}

    def owns(self, name: str) -> bool:
        """Say whether a module of that name would belong to the package."""
        return name == self.package or name.startswith(f"{self.package}.")

    def module(self, name: str) -> Module | None:
        """Return a module of the package, or None where there is none of that name."""
        if name not in self._modules:
            base = self.root.joinpath(*name.split("."))
            candidates = (base / "__init__.py", base.with_suffix(".py")) if self.owns(name) else ()
            path = next((path for path in candidates if path.is_file()), None)
            self._modules[name] = Module(self, name, path) if path else None
        return self._modules[name]

    def find(self, path: str) -> list[Definition]:
        """Return what ``module:name``, ``module:Class.method`` (its class) or ``module`` (all of it) stands for.

        Raises
        ------
        CodeError
            It stands for nothing.
        """
        name, _, inside = path.partition(":")
        wanted, _, method = inside.partition(".")
        module = self.module(name)
        found = [] if module is None else module.definitions.get(wanted, []) if wanted else module.everything
        if method:
            found = [one for one in found if method in map(name_of, ast.walk(one.statements[0]))]
        if module is None or (wanted and not found):
            raise CodeError(f"no {path} in {self.root}")
        return found


class Module:
    """One source file."""

    def __init__(self, sources: Sources, name: str, path: pathlib.Path) -> None:
        self.sources, self.name, self.path = sources, name, path
        self.definitions: dict[str, list[Definition]] = {}
        self.imports: Imports = {}
        self.imported: list[str] = []
        """Modules of the package that importing this one imports."""
        self._meanings: dict[str, list[Meaning]] = {}
        body = [one for one in _parse(path.read_text(encoding="utf-8")).body if _is_executed(one)]
        for statement in body:
            for node in _imports(statement):
                self.imported += self.note(node, self.imports)
            names = () if isinstance(statement, Import) else tuple(dict.fromkeys(_bound(statement)))
            definition = Definition(self, (statement,), names)
            for bound in names:
                self.definitions.setdefault(bound, []).append(definition)
        doings = tuple(one for one in body if not isinstance(one, Import) and _does_something(one))
        self._doings = [Definition(self, doings, ())] if doings else []

    @property
    def everything(self) -> list[Definition]:
        """All definitions, and what the module does while being imported."""
        return [*dict.fromkeys(one for found in self.definitions.values() for one in found), *self._doings]

    @cached_property
    def effects(self) -> list[Definition]:
        """What importing the module does beside defining things, and definitions that may do more than that."""
        return [one for one in self.everything if not one.names or self._calls(one.statements[0])]

    def note(self, node: Import, into: Imports) -> list[str]:
        """Add what an import statement binds; return the modules of the package that it imports."""
        if isinstance(node, ast.Import):
            for alias in node.names:
                target = alias.name if alias.asname else alias.name.partition(".")[0]
                into.setdefault(alias.asname or target, []).append((target, None))
            return [alias.name for alias in node.names if self.sources.owns(alias.name)]
        base = self._absolute(node)
        for alias in node.names:
            into.setdefault(alias.asname or alias.name, []).append((base, alias.name))
        if not self.sources.owns(base):
            return []
        below = [f"{base}.{alias.name}" for alias in node.names]
        return [base, *(name for name in below if self.sources.module(name))]

    def find(self, name: str) -> list[Meaning]:
        """Return what a name at the top of this module stands for."""
        if name not in self._meanings:
            self._meanings[name] = []  # what modules import from each other in a circle ends here
            below = self.sources.module(f"{self.name}.{name}")
            found: list[Meaning] = [(name, one) for one in self.definitions.get(name, ())]
            found += [below] if below and not found else []
            # A package that imports its own module under the module's name only says again what is there.
            found += self.resolve(one for one in self.imports.get(name, ()) if one != (self.name, name))
            self._meanings[name] = found
        return self._meanings[name]

    def resolve(self, targets: Iterable[tuple[str, str | None]]) -> list[Meaning]:
        """Return what the targets of import statements stand for."""
        found: list[Meaning] = []
        for base, attribute in targets:
            module = self.sources.module(base)
            if module is None:
                found.append(External(base if attribute is None else f"{base}.{attribute}"))
            elif attribute is None:
                found.append(module)
            else:
                found += module.find(attribute) or [module]
        return found

    def meaning(self, node: ast.AST | None, local: Imports | None = None) -> list[Meaning]:
        """Return what a name or a chain of attributes stands for, where ``local`` imports are in force."""
        if isinstance(node, ast.Name):
            return self.resolve(local[node.id]) if local and node.id in local else self.find(node.id)
        if isinstance(node, ast.Attribute):
            modules = [one for one in self.meaning(node.value, local) if isinstance(one, Module)]
            return [inner for one in modules for inner in (one.find(node.attr) or [one])]
        return []

    def called(self, statement: ast.stmt) -> list[Meaning]:
        """Return what defining something calls: decorators, hooks for subclasses, functions in a value."""
        calls: list[ast.expr] = []
        if isinstance(statement, Function | ast.ClassDef):
            calls += statement.decorator_list
        if isinstance(statement, ast.ClassDef):
            calls += [keyword.value for keyword in statement.keywords]
            calls += [base for base in statement.bases if any(map(_sees_subclasses, self.meaning(base)))]
        if isinstance(statement, ast.Assign | ast.AnnAssign | ast.Expr) and statement.value is not None:
            calls += [node for node in ast.walk(statement.value) if isinstance(node, ast.Call)]
        functions = [call.func if isinstance(call, ast.Call) else call for call in calls]
        return [found for function in functions for found in self.meaning(function)]

    def _calls(self, statement: ast.stmt) -> bool:
        """Say whether defining something calls a function of the package, and so may do anything."""
        if isinstance(statement, ast.ClassDef) and (statement.keywords or statement.bases):
            return any(isinstance(found, tuple) for found in self.called(statement))
        return any(isinstance(found, tuple) and not _is_class(found) for found in self.called(statement))

    def _absolute(self, node: ast.ImportFrom) -> str:
        if node.level == 0:
            return node.module or ""
        package = self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]
        parts = package.split(".")
        return ".".join([*parts[: len(parts) - node.level + 1], *([node.module] if node.module else [])])


def name_of(node: ast.AST) -> str:
    """Return the name of a function or class; of anything else, nothing."""
    return node.name if isinstance(node, Function | ast.ClassDef) else ""


def is_docstring(node: object) -> bool:
    """Say whether a statement is only a string."""
    constant = node.value if isinstance(node, ast.Expr) else None
    return isinstance(constant, ast.Constant) and isinstance(constant.value, str)


@cache
def _parse(text: str) -> ast.Module:
    return ast.parse(text)


def _is_executed(statement: ast.stmt) -> bool:
    """Say whether importing the module executes a statement: not what is for type checkers or for scripts."""
    if not isinstance(statement, ast.If):
        return not is_docstring(statement)
    return ast.unparse(statement.test) not in (
        "TYPE_CHECKING",
        "typing.TYPE_CHECKING",
        "__name__ == '__main__'",
    )


def _does_something(statement: ast.stmt) -> bool:
    """Say whether a statement does more than to bind names."""
    if isinstance(statement, Function | ast.ClassDef | ast.Pass):
        return False
    if isinstance(statement, ast.Assign):
        targets = [node for target in statement.targets for node in ast.walk(target)]
        return any(isinstance(node, ast.Attribute | ast.Subscript) for node in targets)
    return not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name))


def _bound(node: ast.AST) -> Iterator[str]:
    """Yield the names that a statement binds, but for those that it imports."""
    if isinstance(node, Function | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id
    elif not isinstance(node, ast.comprehension | ast.Lambda):  # whose names are their own
        for child in ast.iter_child_nodes(node):
            yield from _bound(child)


def _imports(statement: ast.stmt) -> Iterator[Import]:
    """Yield the import statements that run when a top-level statement does."""
    if isinstance(statement, Import):
        yield statement
    elif not isinstance(statement, Function | ast.ClassDef):
        yield from (node for node in ast.walk(statement) if isinstance(node, Import))


def _sees_subclasses(found: Meaning) -> bool:
    """Say whether a base class is told when a subclass is defined."""
    return _is_class(found) and "__init_subclass__" in map(name_of, ast.walk(found[1].statements[0]))


def _is_class(found: Meaning) -> TypeGuard[tuple[str, Definition]]:
    return isinstance(found, tuple) and isinstance(found[1].statements[0], ast.ClassDef)
