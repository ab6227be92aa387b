"""The syntax of a definition without the names of its package: tokens, and what the names refer to."""

from __future__ import annotations

import ast
from collections.abc import Collection
from dataclasses import dataclass, field

from bgn.results.sources import Definition, External, Function, Import, Imports, Module, is_docstring, name_of

#: Handlers of these do not swallow an error of the program.
_INTERRUPTS = {"KeyboardInterrupt", "SystemExit"}
_DOCUMENTED = Function | ast.ClassDef


@dataclass(frozen=True)
class Reading:
    """What of a definition counts."""

    raises: bool
    """Whether what it raises does."""
    without: frozenset[str] = frozenset()
    """Methods that do not."""
    fields: bool = True
    """Whether a class's annotated fields do."""


@dataclass(eq=False)
class Syntax:
    """A definition as it counts."""

    tokens: list[str] = field(default_factory=list)
    references: list[tuple[str, Definition]] = field(default_factory=list)
    """What the tokens refer to, in order, each with its place among the names that its definition binds."""
    followed: list[Definition] = field(default_factory=list)
    """What annotations refer to: it counts too, but is not referred to by anything that is executed."""
    imports: list[str] = field(default_factory=list)
    """Modules of the package that are imported meanwhile."""
    swallows: bool = False
    """Whether an error that is raised may be caught and forgotten."""


def read(definition: Definition, reading: Reading) -> Syntax:
    """Read a definition; equal for every Python that parses it to the same tree."""
    reader = _Reader(definition.module, reading)
    for statement in definition.statements:
        reader.top(statement)
    return reader.syntax


class _Reader:
    def __init__(self, module: Module, reading: Reading) -> None:
        self.module, self.reading = module, reading
        self.syntax = Syntax()
        self._local: Imports = {}

    def top(self, statement: ast.stmt) -> None:
        """Read a top-level statement, whose own name does not count."""
        if isinstance(statement, ast.ClassDef):
            statement = self._cut(statement)
        for node in ast.walk(statement):
            if isinstance(node, Import):
                self.syntax.imports += self.module.note(node, self._local)
        self._node(statement, skip=("name",) if isinstance(statement, _DOCUMENTED) else ())

    def _cut(self, statement: ast.ClassDef) -> ast.ClassDef:
        """Return a class without what does not count; the types of its fields are followed all the same."""
        kept = [one for one in statement.body if name_of(one) not in self.reading.without]
        if not self.reading.fields:
            fields = [one for one in kept if isinstance(one, ast.AnnAssign)]
            for one in fields:
                self._follow(one.annotation)
            kept = [one for one in kept if one not in fields]
        return ast.ClassDef(**{**dict(ast.iter_fields(statement)), "body": kept})

    def _node(self, node: ast.AST, skip: Collection[str] = (), *, in_class: bool = False) -> None:
        tokens = self.syntax.tokens
        if isinstance(node, Import) or self._resolved(node):
            return
        if isinstance(node, ast.Raise) and not self.reading.raises:
            tokens.append("(Raise)")
            return
        self.syntax.swallows |= self._swallows(node)
        tokens.append(f"({type(node).__name__}")
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns") and not in_class:
                self._follow(value)
            elif isinstance(node, ast.Constant):
                tokens.append(repr(value) if name == "value" else "")
            elif value not in (None, []) and name not in ("ctx", "type_comment", *skip):
                # Fields that newer versions of Python add are empty for older code.
                tokens.append(f".{name}")
                self._values(node, value)
        tokens.append(")")

    def _values(self, node: ast.AST, value: object) -> None:
        for child in value if isinstance(value, list) else [value]:
            if isinstance(node, _DOCUMENTED) and is_docstring(child):
                continue
            if isinstance(child, ast.AST):
                is_field = isinstance(node, ast.ClassDef) and isinstance(child, ast.AnnAssign)
                self._node(child, in_class=is_field)
            else:
                self.syntax.tokens.append(repr(child))

    def _follow(self, annotation: ast.AST | None) -> None:
        """Follow the names of an annotation, which is not executed."""
        if annotation is not None:
            reader = _Reader(self.module, self.reading)
            reader._local = self._local
            reader._node(annotation)
            self.syntax.followed += [one for _, one in reader.syntax.references]
            self.syntax.imports += reader.syntax.imports

    def _resolved(self, node: ast.AST) -> bool:
        """Replace a name of the package, or of another distribution, by what it means; False if it is neither."""
        meanings = self.module.meaning(node, self._local)
        for meaning in meanings:
            if isinstance(meaning, External):
                self.syntax.tokens.append(f"({meaning.name})")
            elif isinstance(meaning, Module):
                self.syntax.tokens.append("(module)")
                self.syntax.imports.append(meaning.name)
                self.syntax.references += [("", one) for one in meaning.everything]
            else:
                name, definition = meaning
                self.syntax.tokens.append("(own)")
                self.syntax.references.append((str(definition.names.index(name)), definition))
        return bool(meanings)

    def _swallows(self, node: ast.AST) -> bool:
        """Say whether a node can catch an error that the package raises, and go on."""
        if not isinstance(node, ast.ExceptHandler):
            name = node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")
            return name == "suppress"
        kinds = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
        return any(map(self._may_be_ours, kinds)) and not isinstance(node.body[-1], ast.Raise)

    def _may_be_ours(self, kind: ast.expr | None) -> bool:
        """Say whether a handler of such errors can catch one that the package raises."""
        if isinstance(kind, ast.Attribute):  # such as json.JSONDecodeError
            outer = self.module.meaning(kind.value, self._local)
            return not any(isinstance(one, External) for one in outer)
        return not (isinstance(kind, ast.Name) and kind.id in _INTERRUPTS)
