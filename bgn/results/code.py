"""A hash of the code that a run executes, which does not see where that code stands.

What counts is the graph of top-level definitions (functions, classes, constants) that can be reached by name
from where a run starts. A definition counts by its syntax, in which every name of the own package is replaced
by what it refers to: neither the names of modules and definitions nor import statements are part of the hash,
and moving or renaming a module or a definition changes nothing. Comments, docstrings, layout and the annotations
of functions do not count either.

Where the graph cannot be sharp it covers too much: a class counts with all its methods, a name that is bound
twice with both bindings, a module that is handed around as an object with everything in it. Annotations are
followed, so that the methods of what a run is handed count too. Of every module that is imported on the way, what
it does while being imported counts: its top-level statements that are no definitions, and its definitions that
call, or are decorated by, functions of the package.

An error ends a run, which then has no result: what is raised counts only where one may be caught and
swallowed. What is imported under a computed name is not followed.
"""

from __future__ import annotations

import ast
import hashlib
import pathlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import TypeAlias

#: Handlers of these do not swallow an error of the program.
_INTERRUPTS = {"KeyboardInterrupt", "SystemExit"}
_Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
_Import = ast.Import | ast.ImportFrom


class CodeError(LookupError):
    """A scope names a module or definition that is not there."""


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Where a run starts, and what is left out; ``package.module`` or ``package.module:definition``."""

    entries: tuple[str, ...]
    """What is called, and the classes of what it is handed."""
    without: tuple[str, ...] = ()
    """What is neither followed nor counted, nor what only it needs; may be a method: ``module:Class.method``."""
    data: tuple[str, ...] = ()
    """Dataclasses whose fields are hashed with the data: only their methods count."""


@dataclass(frozen=True, eq=False)
class Definition:
    """One or more top-level statements of a module."""

    module: _Module
    statements: tuple[ast.stmt, ...]
    names: tuple[str, ...]
    """What they bind."""


@dataclass(frozen=True)
class _External:
    """Something of another distribution, by its dotted name."""

    name: str


#: What a name stands for; a definition with the one of its names that it was found under.
_Meaning: TypeAlias = "tuple[str, Definition] | _Module | _External"


@dataclass(eq=False)
class _Syntax:
    """A definition's tokens without the package's names, and what the names refer to, in order."""

    tokens: list[str] = field(default_factory=list)
    references: list[tuple[str, Definition]] = field(default_factory=list)
    imports: list[str] = field(default_factory=list)
    """The package's modules that it imports."""
    swallows: bool = False

    def refer(self, name: str, definition: Definition) -> None:
        self.references.append((str(definition.names.index(name)) if name else "", definition))


@dataclass(frozen=True)
class _Reading:
    """What of a definition counts."""

    raises: bool
    """Whether what it raises does."""
    without: frozenset[str] = frozenset()
    """Methods that do not."""
    fields: bool = True
    """Whether a class's annotated fields do."""


class CodeTree:
    """The sources of a package, read once."""

    def __init__(self, root: pathlib.Path, package: str = "bgn") -> None:
        """Read the package as it stands in the folder ``root``."""
        self.root, self.package = root, package
        self._modules: dict[str, _Module | None] = {}
        self._syntax: dict[tuple[Definition, _Reading], _Syntax] = {}

    def hash(self, scope: Scope) -> str:
        """Hash what a scope covers; MuJoCo's XML files count where definitions beside them do.

        Raises
        ------
        CodeError
            The scope names what is not there.
        """
        reached = self._reach(scope)
        colours = _colours(reached)
        scenes = {scene for one in reached for scene in one.module.path.parent.glob("*.xml")}
        described = {*colours.values(), *(_digest(scene.read_bytes()) for scene in scenes)}
        starts = [colours[one] for entry in scope.entries for one in self.find(entry)]
        return _digest("\n".join([*starts, *sorted(described)]).encode())

    def reached(self, scope: Scope) -> set[str]:
        """Return what counts, as ``module:name``; ``module:`` is what a module does while being imported."""
        return {f"{one.module.name}:{name}" for one in self._reach(scope) for name in one.names or ("",)}

    def find(self, path: str) -> list[Definition]:
        """Return the definitions that ``module:name`` stands for (``module``: all of it).

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
            found = [one for one in found if method in {*map(_name, ast.walk(one.statements[0]))}]
        if module is None or (wanted and not found):
            raise CodeError(f"no {path} in {self.root}")
        return found

    def module(self, name: str) -> _Module | None:
        """Return a module of the package, or None where there is none of that name."""
        if name not in self._modules:
            base = self.root.joinpath(*name.split("."))
            paths = (base / "__init__.py", base.with_suffix(".py"))
            path = next((path for path in paths if path.is_file()), None)
            inside = name == self.package or name.startswith(f"{self.package}.")
            self._modules[name] = _Module(self, name, path) if path and inside else None
        return self._modules[name]

    def _reach(self, scope: Scope) -> Mapping[Definition, _Syntax]:
        for path in (*scope.without, *scope.data):
            self.find(path)
        for raises in (False, True):
            reached = _Walk(self, scope, raises).run()
            if not any(syntax.swallows for syntax in reached.values()):
                break
        return reached

    def syntax(self, definition: Definition, reading: _Reading) -> _Syntax:
        """Return a definition's syntax, read in one way."""
        if (definition, reading) not in self._syntax:
            reader = _Reader(definition.module, reading)
            for statement in definition.statements:
                reader.top(statement)
            self._syntax[definition, reading] = reader.syntax
        return self._syntax[definition, reading]


class _Module:
    """One source file: what it defines, imports, and does while it is imported."""

    def __init__(self, tree: CodeTree, name: str, path: pathlib.Path) -> None:
        self.tree, self.name, self.path = tree, name, path
        self.package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        self.definitions: dict[str, list[Definition]] = {}
        self.imports: dict[str, list[tuple[str, str | None]]] = {}
        self.imported: list[str] = []
        doings: list[ast.stmt] = []
        self._body = [one for one in _parse(path.read_text(encoding="utf-8")).body if _executed(one)]
        for statement in self._body:
            for node in _imports(statement):
                self.imported += self.note_imports(node, self.imports)
            if isinstance(statement, _Import):
                continue
            names = tuple(dict.fromkeys(_bound(statement)))
            if _does_something(statement):
                doings.append(statement)
            for name_bound in names:
                one = Definition(self, (statement,), names)
                self.definitions.setdefault(name_bound, []).append(one)
        self._doings = Definition(self, tuple(doings), ()) if doings else None

    @property
    def everything(self) -> list[Definition]:
        """All definitions, and what the module does while being imported."""
        own = [one for found in self.definitions.values() for one in found]
        return [*own, *([self._doings] if self._doings else [])]

    @cached_property
    def effects(self) -> list[Definition]:
        """What importing the module does beside defining things."""
        found = [self._doings] if self._doings else []
        return [*found, *(one for names in self.definitions.values() for one in names if self._calls(one))]

    def note_imports(self, node: _Import, into: dict[str, list[tuple[str, str | None]]]) -> list[str]:
        """Add what an import statement binds; return the modules of the package that it imports."""
        if isinstance(node, ast.Import):
            for alias in node.names:
                target = alias.name if alias.asname else alias.name.partition(".")[0]
                into.setdefault(alias.asname or target, []).append((target, None))
            return [alias.name for alias in node.names if self._own(alias.name)]
        base = self._absolute(node)
        for alias in node.names:
            into.setdefault(alias.asname or alias.name, []).append((base, alias.name))
        if not self._own(base):
            return []
        below = [f"{base}.{alias.name}" for alias in node.names]
        return [base, *(name for name in below if self.tree.module(name))]

    def find(self, name: str) -> list[_Meaning]:
        """Return what a name means in this module: definitions, modules, or things of other distributions."""
        if name in self.definitions:
            return [(name, one) for one in self.definitions[name]]
        below = self.tree.module(f"{self.name}.{name}")
        found: list[_Meaning] = [below] if below else []
        # A package that imports its own module under the module's name only says again what is there.
        return found + self.resolve(one for one in self.imports.get(name, ()) if one != (self.name, name))

    def resolve(self, targets: Iterable[tuple[str, str | None]]) -> list[_Meaning]:
        """Return what the targets of import statements mean."""
        found: list[_Meaning] = []
        for base, attribute in targets:
            module = self.tree.module(base)
            if module is None:
                found.append(_External(base if attribute is None else f"{base}.{attribute}"))
            elif attribute is None:
                found.append(module)
            else:
                found += module.find(attribute) or [module]
        return found

    def _calls(self, one: Definition) -> bool:
        """Say whether defining something calls a function of the package."""
        (statement,) = one.statements
        called: list[ast.expr] = []
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            called += statement.decorator_list
        if isinstance(statement, ast.ClassDef):
            called += [keyword.value for keyword in statement.keywords]
            if any(_hooks(found) for base in statement.bases for found in self._meaning(base)):
                return True
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            called += [node.func for node in ast.walk(statement.value) if isinstance(node, ast.Call)]
        return any(
            isinstance(found, tuple) and not isinstance(found[1].statements[0], ast.ClassDef)
            for expression in called
            for found in self._meaning(expression.func if isinstance(expression, ast.Call) else expression)
        )

    def _meaning(self, node: ast.expr) -> list[_Meaning]:
        if isinstance(node, ast.Name):
            return self.find(node.id)
        if isinstance(node, ast.Attribute):
            outer = self._meaning(node.value)
            return [inner for one in outer if isinstance(one, _Module) for inner in one.find(node.attr)]
        return []

    def _own(self, name: str) -> bool:
        return name == self.tree.package or name.startswith(f"{self.tree.package}.")

    def _absolute(self, node: ast.ImportFrom) -> str:
        if node.level == 0:
            return node.module or ""
        parts = self.package.split(".")
        base = parts[: len(parts) - node.level + 1]
        return ".".join([*base, *([node.module] if node.module else [])])


class _Walk:
    """One walk through the definitions, from where a run starts."""

    def __init__(self, tree: CodeTree, scope: Scope, raises: bool) -> None:
        self.tree, self.raises = tree, raises
        self.cut = {path for path in scope.without if "." not in path.partition(":")[2]}
        self.methods = {path for path in scope.without if path not in self.cut}
        self.data = {one for path in scope.data for one in tree.find(path)}
        self.found: dict[Definition, _Syntax] = {}
        self._waiting = [one for path in scope.entries for one in tree.find(path)]
        self._entered: set[str] = set()

    def run(self) -> Mapping[Definition, _Syntax]:
        while self._waiting:
            definition = self._waiting.pop()
            if definition in self.found or self._is_cut(definition):
                continue
            syntax = self.found[definition] = self._read(definition)
            self._waiting += [one for _, one in syntax.references]
            for name in (definition.module.name, *syntax.imports):
                self._enter(name)
        return self.found

    def _enter(self, name: str) -> None:
        """Count what a module does while it is imported, with the packages around it and what it imports."""
        waiting = [name]
        while waiting:
            name = waiting.pop()
            module = self.tree.module(name)
            if module is None or name in self._entered or name in self.cut:
                continue
            self._entered.add(name)
            self._waiting += [one for one in module.effects if not self._calls_cut(one)]
            waiting += [name.rpartition(".")[0], *module.imported]

    def _read(self, one: Definition) -> _Syntax:
        prefixes = tuple(f"{one.module.name}:{name}." for name in one.names)
        methods = frozenset(path.rpartition(".")[2] for path in self.methods if path.startswith(prefixes))
        syntax = self.tree.syntax(one, _Reading(self.raises, methods, one not in self.data))
        kept = [(label, to) for label, to in syntax.references if not self._is_cut(to)]
        return _Syntax(syntax.tokens, kept, syntax.imports, syntax.swallows)

    def _is_cut(self, one: Definition) -> bool:
        module = one.module.name
        return module in self.cut or any(f"{module}:{name}" in self.cut for name in one.names)

    def _calls_cut(self, one: Definition) -> bool:
        """Say whether something is only there to call what is cut: a decorated definition, or a bare call."""
        if len(one.statements) != 1:
            return False
        (statement,) = one.statements
        calls: list[ast.expr] = []
        if isinstance(statement, ast.Expr):
            calls = [statement.value]
        elif isinstance(statement, ast.FunctionDef | ast.ClassDef):
            calls = statement.decorator_list
        functions = [call.func if isinstance(call, ast.Call) else call for call in calls]
        return any(
            isinstance(found, tuple) and self._is_cut(found[1])
            for function in functions
            for found in one.module._meaning(function)
        )


class _Reader:
    """Turns a definition into tokens and references."""

    def __init__(self, module: _Module, reading: _Reading) -> None:
        self.module, self.reading = module, reading
        self.syntax = _Syntax()
        self._local: dict[str, list[tuple[str, str | None]]] = {}

    def top(self, statement: ast.stmt) -> None:
        """Read a top-level statement, whose own name does not count."""
        if isinstance(statement, ast.ClassDef):
            statement = self._cut(statement)
        for node in ast.walk(statement):
            if isinstance(node, _Import):
                self.syntax.imports += self.module.note_imports(node, self._local)
        self._node(statement, skip={"name"} if isinstance(statement, _Documented) else set())

    def _cut(self, statement: ast.ClassDef) -> ast.ClassDef:
        """Return a class without what does not count; the types of fields are followed all the same."""
        kept = [one for one in statement.body if _name(one) not in self.reading.without]
        if not self.reading.fields:
            fields = [one for one in kept if isinstance(one, ast.AnnAssign)]
            for one in fields:
                self._follow(one.annotation)
            kept = [one for one in kept if one not in fields]
        return ast.ClassDef(**{**dict(ast.iter_fields(statement)), "body": kept})

    def _node(self, node: ast.AST, skip: Iterable[str] = (), in_class: bool = False) -> None:
        tokens = self.syntax.tokens
        if isinstance(node, _Import) or self._resolved(node):
            return
        if isinstance(node, ast.Raise) and not self.reading.raises:
            tokens.append("(Raise)")
            return
        self.syntax.swallows |= self._swallows(node)
        tokens.append(f"({type(node).__name__}")
        for name, value in ast.iter_fields(node):
            if name in skip or name in ("ctx", "type_comment"):
                continue
            if name in ("annotation", "returns") and not in_class:
                self._follow(value)
            elif isinstance(node, ast.Constant):
                tokens.append(repr(value) if name == "value" else "")
            elif value not in (None, []):  # fields that newer versions of Python add are empty for older code
                tokens.append(f".{name}")
                self._values(node, value)
        tokens.append(")")

    def _values(self, node: ast.AST, value: object) -> None:
        children = value if isinstance(value, list) else [value]
        for child in children:
            if isinstance(node, _Documented) and _is_string(child):
                continue
            if isinstance(child, ast.AST):
                is_field = isinstance(node, ast.ClassDef) and isinstance(child, ast.AnnAssign)
                self._node(child, in_class=is_field)
            else:
                self.syntax.tokens.append(repr(child))

    def _follow(self, annotation: ast.AST | None) -> None:
        """Follow an annotation's names, which are not executed, without counting its syntax."""
        if annotation is not None:
            kept = len(self.syntax.tokens)
            self._node(annotation)
            del self.syntax.tokens[kept:]

    def _resolved(self, node: ast.AST) -> bool:
        """Replace a name of the package, or of another distribution, by what it means; False if it is neither."""
        meanings = self._meaning(node)
        for meaning in meanings:
            if isinstance(meaning, _External):
                self.syntax.tokens.append(f"({meaning.name})")
            elif isinstance(meaning, _Module):
                self.syntax.tokens.append("(module)")
                self.syntax.imports.append(meaning.name)
                for one in meaning.everything:
                    self.syntax.refer("", one)
            else:
                self.syntax.tokens.append("(own)")
                self.syntax.refer(*meaning)
        return bool(meanings)

    def _swallows(self, node: ast.AST) -> bool:
        """Say whether a node can catch an error that the package raises, and go on."""
        if not isinstance(node, ast.ExceptHandler):
            named = node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")
            return named == "suppress"
        kinds = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
        return any(map(self._may_be_ours, kinds)) and not isinstance(node.body[-1], ast.Raise)

    def _may_be_ours(self, kind: ast.expr | None) -> bool:
        """Say whether a handler of such errors can catch one that the package raises."""
        if isinstance(kind, ast.Attribute):  # such as json.JSONDecodeError
            return not any(isinstance(one, _External) for one in self._meaning(kind.value))
        return not (isinstance(kind, ast.Name) and kind.id in _INTERRUPTS)

    def _meaning(self, node: ast.AST) -> list[_Meaning]:
        if isinstance(node, ast.Name):
            return (
                self.module.resolve(self._local[node.id])
                if node.id in self._local
                else self.module.find(node.id)
            )
        if isinstance(node, ast.Attribute):
            outer = self._meaning(node.value)
            modules = [one for one in outer if isinstance(one, _Module)]
            return [inner for one in modules for inner in (one.find(node.attr) or [one])]
        return []


def _colours(reached: Mapping[Definition, _Syntax]) -> Mapping[Definition, str]:
    """Give every definition a hash over itself and all it refers to, equal for definitions that do the same.

    The references form circles, so the hashes are refined round by round, as a finite automaton is minimised.
    """
    colours = {one: _digest(" ".join(syntax.tokens).encode()) for one, syntax in reached.items()}
    different = 0
    while different < (different := len(set(colours.values()))):
        colours = {
            one: _digest(
                " ".join(
                    [colours[one], *(f"{label}:{colours[to]}" for label, to in syntax.references)]
                ).encode()
            )
            for one, syntax in reached.items()
        }
    return colours


@cache
def _parse(text: str) -> ast.Module:
    return ast.parse(text)


def _executed(statement: ast.stmt) -> bool:
    """Say whether importing the module executes a statement: not what is for type checkers or for scripts."""
    if not isinstance(statement, ast.If):
        return not _is_string(statement)
    return ast.unparse(statement.test) not in (
        "TYPE_CHECKING",
        "typing.TYPE_CHECKING",
        "__name__ == '__main__'",
    )


def _does_something(statement: ast.stmt) -> bool:
    """Say whether a statement does more than to bind names."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Pass):
        return False
    if isinstance(statement, ast.Assign):
        targets = [node for target in statement.targets for node in ast.walk(target)]
        return any(isinstance(node, ast.Attribute | ast.Subscript) for node in targets)
    return not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name))


def _bound(statement: ast.AST) -> Iterator[str]:
    """Yield the names that a statement binds, but for those that it imports."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield statement.name
    elif isinstance(statement, ast.Name) and isinstance(statement.ctx, ast.Store):
        yield statement.id
    elif not isinstance(statement, ast.comprehension | ast.Lambda):  # whose names are their own
        for node in ast.iter_child_nodes(statement):
            yield from _bound(node)


def _imports(statement: ast.stmt) -> Iterator[_Import]:
    """Yield the import statements that run when a top-level statement does."""
    if isinstance(statement, _Import):
        yield statement
    elif not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield from (node for node in ast.walk(statement) if isinstance(node, _Import))


def _hooks(found: object) -> bool:
    """Say whether a base class sees its subclasses being defined."""
    if not isinstance(found, tuple):
        return False
    statement = found[1].statements[0]
    return isinstance(statement, ast.ClassDef) and "__init_subclass__" in {
        node.name for node in statement.body if isinstance(node, ast.FunctionDef)
    }


def _name(node: ast.AST) -> str:
    """Return the name of a function or class; of anything else, nothing."""
    return node.name if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) else ""


def _is_string(node: object) -> bool:
    constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return constant and isinstance(node.value.value, str)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
