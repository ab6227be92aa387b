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
forgotten. What is imported under a computed name is not followed.
"""

from __future__ import annotations

import hashlib
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass

from bgn.results.sources import Definition, Sources
from bgn.results.syntax import Reading, Syntax, read


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Where a run starts, and what is left out; ``package.module`` or ``package.module:definition``."""

    entries: tuple[str, ...]
    """What is called, and the classes of what it is handed."""
    without: tuple[str, ...] = ()
    """What is neither followed nor counted, nor what only it needs; may be a method: ``module:Class.method``."""
    data: tuple[str, ...] = ()
    """Dataclasses whose fields are hashed with the data: only their methods count."""


class CodeTree:
    """The code of a package as it stands in a folder."""

    def __init__(self, root: pathlib.Path, package: str = "bgn") -> None:
        """Use the package in the folder ``root``, reading every file once."""
        self.sources = Sources(root, package)
        self._read: dict[tuple[Definition, Reading], Syntax] = {}

    def hash(self, scope: Scope) -> str:
        """Hash what a scope covers; MuJoCo's XML files count where definitions beside them do.

        Raises
        ------
        bgn.results.sources.CodeError
            The scope names what is not there.
        """
        reached = self._reach(scope)
        colours = _colours(reached)
        scenes = {scene for one in reached for scene in one.module.path.parent.glob("*.xml")}
        described = {*colours.values(), *(_digest(scene.read_bytes()) for scene in scenes)}
        starts = [colours[one] for entry in scope.entries for one in self.sources.find(entry)]
        return _digest("\n".join([*starts, *sorted(described)]).encode())

    def reached(self, scope: Scope) -> set[str]:
        """Return what counts, as ``module:name``; ``module:`` is what a module does while being imported."""
        return {f"{one.module.name}:{name}" for one in self._reach(scope) for name in one.names or ("",)}

    def syntax(self, definition: Definition, reading: Reading) -> Syntax:
        """Return a definition as it counts."""
        if (definition, reading) not in self._read:
            self._read[definition, reading] = read(definition, reading)
        return self._read[definition, reading]

    def _reach(self, scope: Scope) -> Mapping[Definition, Syntax]:
        for path in scope.without:
            self.sources.find(path)
        reached = _Walk(self, scope, raises=False).run()
        if any(syntax.swallows for syntax in reached.values()):
            reached = _Walk(self, scope, raises=True).run()
        return reached


class _Walk:
    """One walk through the definitions, from where a run starts."""

    def __init__(self, tree: CodeTree, scope: Scope, *, raises: bool) -> None:
        self.tree, self.raises = tree, raises
        self.cut = {path for path in scope.without if "." not in path.partition(":")[2]}
        self.methods = {path for path in scope.without if path not in self.cut}
        self.data = {one for path in scope.data for one in tree.sources.find(path)}
        self.found: dict[Definition, Syntax] = {}
        self._waiting = [one for path in scope.entries for one in tree.sources.find(path)]
        self._entered: set[str] = set()

    def run(self) -> Mapping[Definition, Syntax]:
        while self._waiting:
            definition = self._waiting.pop()
            if definition in self.found or self._is_cut(definition):
                continue
            syntax = self.found[definition] = self._syntax(definition)
            self._waiting += [*(one for _, one in syntax.references), *syntax.followed]
            for name in (definition.module.name, *syntax.imports):
                self._enter(name)
        return self.found

    def _enter(self, name: str) -> None:
        """Count what a module does while it is imported, with the packages around it and what it imports."""
        waiting = [name]
        while waiting:
            name = waiting.pop()
            module = self.tree.sources.module(name)
            if module is None or name in self._entered or name in self.cut:
                continue
            self._entered.add(name)
            self._waiting += [one for one in module.effects if not self._calls_cut(one)]
            waiting += [name.rpartition(".")[0], *module.imported]

    def _syntax(self, one: Definition) -> Syntax:
        prefixes = tuple(f"{one.module.name}:{name}." for name in one.names)
        methods = frozenset(path.rpartition(".")[2] for path in self.methods if path.startswith(prefixes))
        syntax = self.tree.syntax(one, Reading(self.raises, methods, one not in self.data))
        kept = [(place, to) for place, to in syntax.references if not self._is_cut(to)]
        return Syntax(syntax.tokens, kept, syntax.followed, syntax.imports, syntax.swallows)

    def _is_cut(self, one: Definition) -> bool:
        module = one.module.name
        return module in self.cut or any(f"{module}:{name}" in self.cut for name in one.names)

    def _calls_cut(self, one: Definition) -> bool:
        """Say whether something is only there to call what is cut, such as a registry that is left out."""
        called = one.module.called(one.statements[0]) if len(one.statements) == 1 else []
        return any(isinstance(found, tuple) and self._is_cut(found[1]) for found in called)


def _colours(reached: Mapping[Definition, Syntax]) -> Mapping[Definition, str]:
    """Give every definition a hash over itself and all it refers to, equal for definitions that do the same.

    The references form circles, so the hashes are refined round by round, as a finite automaton is minimised.
    """
    colours = {one: _digest(" ".join(syntax.tokens).encode()) for one, syntax in reached.items()}
    different = 0
    while different < (different := len(set(colours.values()))):
        colours = {one: _refined(colours, one, syntax) for one, syntax in reached.items()}
    return colours


def _refined(colours: Mapping[Definition, str], one: Definition, syntax: Syntax) -> str:
    """Return a definition's next hash: its own before, and those of what it refers to."""
    parts = [colours[one], *(f"{place}:{colours[to]}" for place, to in syntax.references)]
    return _digest(" ".join(parts).encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
