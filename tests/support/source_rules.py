"""Rules of naming and of interfaces: `python -m support.source_rules PATH …` lists violations.

The words not to use come from `docs/glossary.md`, so that the page and the rule cannot differ.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

from support.tree import ROOT, SOURCE_ROOTS, tracked_files

GLOSSARY = ROOT / "docs" / "glossary.md"
MOST_POSITIONAL = 4
LEAST_FIELDS = 3
OLD_CITATION = re.compile(
    r"\b[HLMR] \(\d+\)|\([HLMR][,;)]"
    r"|\b[HLMR], (?:steps?|parts?|first|second|third|fourth|fifth|eqs?|priority|reliability)\b"
    r"|\b(?:of|by|in) [HLM](?=[,.:;)])|\b[HLMR]'s (?:formula|step|example|text)"
)
_EXTERNAL = frozenset(
    {"np", "numpy", "math", "struct", "os", "itertools", "subprocess", "pytest", "st", "plt"}
)


@dataclass(frozen=True, kw_only=True)
class Violation:
    """A place that breaks a rule."""

    path: Path
    line: int
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{_shown(self.path)}:{self.line}: {self.rule}: {self.text}"


def _shown(path: Path) -> str:
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.as_posix()


@dataclass(frozen=True, kw_only=True)
class Word:
    """A word that the glossary asks not to use: in identifiers, in texts or in both; not in the folders excepted."""

    word: str
    in_identifiers: bool
    in_texts: bool
    excepted: tuple[str, ...]


@cache
def words() -> tuple[Word, ...]:
    """The rows of the glossary's table of words not to use."""
    section = GLOSSARY.read_text("utf-8").partition("\n## Words not to use\n")[2]
    rows = re.findall(r"^\| ([^|]+) \| (identifiers|texts|both) \| [^|]* \|([^|]*)\|$", section, re.M)
    return tuple(
        Word(
            word=word.strip(),
            in_identifiers=where != "texts",
            in_texts=where != "identifiers",
            excepted=tuple(re.findall(r"`([^`]+)`", excepted)),
        )
        for word, where, excepted in rows
    )


def identifier_words(name: str) -> str:
    """`fooBar_baz` as ` foo bar baz `."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    return f" {' '.join(part.lower() for part in split.split('_') if part)} "


def word_violations(path: Path, text: str) -> Iterator[Violation]:
    """Words not to use, in the identifiers that a file defines, in its comments, docstrings and other texts."""
    listed = [word for word in words() if not _shown(path).startswith(word.excepted or ("\0",))]
    if path.suffix == ".py":
        forbidden = "|".join(re.escape(word.word) for word in listed if word.in_identifiers)
        in_identifier = re.compile(f" ({forbidden}) ")
        for line, name in _defined_names(text):
            for match in in_identifier.finditer(identifier_words(name)):
                yield Violation(path=path, line=line, rule=f"word '{match[1]}' in identifier", text=name)
    in_texts = [word.word for word in listed if word.in_texts]
    pattern = re.compile(rf"\b(?:{'|'.join(map(re.escape, in_texts))})\b", re.IGNORECASE)
    for line, content in _texts(path, text):
        for match in pattern.finditer(content):
            shown = content[max(0, match.start() - 30) : match.end() + 30].replace("\n", " ").strip()
            at = line + content.count("\n", 0, match.start())
            yield Violation(path=path, line=at, rule=f"word '{match[0].lower()}' in text", text=shown)


def _defined_names(text: str) -> Iterator[tuple[int, str]]:
    for node in _nodes(text):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr
        elif isinstance(node, ast.alias) and node.asname:
            yield node.lineno, node.asname


@lru_cache(maxsize=1)
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


@lru_cache(maxsize=1)
def _nodes(text: str) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(_parsed(text)))


def _texts(path: Path, text: str) -> Iterable[tuple[int, str]]:
    if path.suffix == ".py":
        return _python_texts(text)
    return [(1, re.sub(r"`[^`\n]+`", lambda code: " " * len(code[0]), text))]


@lru_cache(maxsize=1)
def _python_texts(text: str) -> tuple[tuple[int, str], ...]:
    return tuple(_comments_and_strings(text))


def _comments_and_strings(text: str) -> Iterator[tuple[int, str]]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            yield token.start[0], re.sub(r"`[^`\n]+`", lambda code: " " * len(code[0]), token.string)


def interface_violations(path: Path, text: str) -> Iterator[Violation]:
    """Calls of Camber's own functions with many positional arguments; dataclasses that are not keyword-only."""
    for node in _nodes(text):
        if isinstance(node, ast.Call) and len(node.args) > MOST_POSITIONAL and _calls_camber(node.func):
            rule = f"{len(node.args)} positional arguments"
            yield Violation(path=path, line=node.lineno, rule=rule, text=ast.unparse(node.func))
        if isinstance(node, ast.ClassDef) and _is_positional_dataclass(node):
            yield Violation(path=path, line=node.lineno, rule="dataclass without kw_only", text=node.name)


def _calls_camber(callee: ast.expr) -> bool:
    if isinstance(callee, ast.Attribute):
        root: ast.expr = callee
        while isinstance(root, ast.Attribute):
            root = root.value
        if isinstance(root, ast.Name) and root.id in _EXTERNAL:
            return False
        return callee.attr in product_names()
    return isinstance(callee, ast.Name) and (callee.id in product_names() or callee.id == "cls")


def _is_positional_dataclass(node: ast.ClassDef) -> bool:
    fields = sum(isinstance(item, ast.AnnAssign) for item in node.body)
    for decorator in node.decorator_list:
        named = decorator.func if isinstance(decorator, ast.Call) else decorator
        if ast.unparse(named).rpartition(".")[2] == "dataclass":
            keywords = decorator.keywords if isinstance(decorator, ast.Call) else []
            return fields >= LEAST_FIELDS and not any(word.arg == "kw_only" for word in keywords)
    return False


@cache
def product_names() -> frozenset[str]:
    """Names of all functions, methods and classes of the product."""
    return frozenset(
        node.name
        for path in product_files()
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
    )


def product_files() -> list[Path]:
    """All modules of both source roots."""
    return [path for root in SOURCE_ROOTS for path in sorted(root.rglob("*.py"))]


def constant_violations(path: Path, text: str) -> Iterator[Violation]:
    """Module-level numbers without a comment on their line, above their block, or a docstring below."""
    body, lines = _parsed(text).body, text.splitlines()
    block_has_source, last = False, -1
    for at, node in enumerate(body):
        target = _number_assigned(node)
        if target is None:
            continue
        first = node.lineno - 1
        if first != last:
            block_has_source = lines[first - 1].lstrip().startswith("#") if first else False
        elif lines[first - 1].lstrip().startswith("#"):
            block_has_source = True
        last = node.end_lineno or first
        followed = at + 1 < len(body) and _is_text(body[at + 1])
        if followed:
            last = body[at + 1].end_lineno or last
        on_line = any("#" in line for line in lines[first : node.end_lineno])
        if not (block_has_source or followed or on_line):
            yield Violation(path=path, line=node.lineno, rule="number without source", text=target)


def _number_assigned(node: ast.stmt) -> str | None:
    if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
        name, value = node.targets[0].id, node.value
    elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
        name, value = node.target.id, node.value
    else:
        return None
    return name if name.strip("_").isupper() and _is_number(value) else None


def _is_number(value: ast.expr) -> bool:
    if isinstance(value, ast.Constant):
        return isinstance(value.value, (int, float)) and not isinstance(value.value, bool)
    if isinstance(value, ast.UnaryOp):
        return _is_number(value.operand)
    if isinstance(value, ast.BinOp):
        return _is_number(value.left) and _is_number(value.right)
    return False


def _is_text(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def citation_violations(path: Path, text: str) -> Iterator[Violation]:
    """Citations by letter, as in `H (3)`, where the document's number is expected."""
    for line, content in _texts(path, text) if path.suffix == ".py" else [(1, text)]:
        for match in OLD_CITATION.finditer(content):
            at = line + content.count("\n", 0, match.start())
            yield Violation(path=path, line=at, rule="citation by letter", text=match[0])


def class_violations(paths: Iterable[Path]) -> Iterator[Violation]:
    """Names of classes with more than one definition."""
    places: dict[str, list[tuple[Path, int]]] = defaultdict(list)
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef):
                places[node.name.lstrip("_")].append((path, node.lineno))
    for name, defined in sorted(places.items()):
        if len(defined) > 1:
            for path, line in defined:
                others = ", ".join(_shown(other) for other, _ in defined if other != path)
                yield Violation(
                    path=path, line=line, rule="class name with several meanings", text=f"{name}: {others}"
                )


def violations(path: Path) -> Iterator[Violation]:
    """All violations of the rules in one file; those of the interfaces and constants for the product alone."""
    text = path.read_text("utf-8")
    yield from word_violations(path, text)
    yield from citation_violations(path, text)
    if path.suffix == ".py" and any(path.is_relative_to(root) for root in SOURCE_ROOTS):
        yield from interface_violations(path, text)
        yield from constant_violations(path, text)


def checked_files() -> list[Path]:
    """Python files and hand-written pages of the repository; the glossary names the words, the changelog is history."""
    left_out = {GLOSSARY, ROOT / "CHANGELOG.md", Path(__file__)}
    return [path for path in tracked_files() if path.suffix in {".py", ".md"} and path not in left_out]


def main(argv: list[str]) -> int:
    """Print violations below the paths given; exit code 1 where there are any."""
    below = [Path(name).resolve() for name in argv] or [ROOT]
    listed = [path for path in checked_files() if any(path == at or path.is_relative_to(at) for at in below)]
    all_found = [violation for path in listed for violation in violations(path)]
    all_found += [item for item in class_violations(product_files()) if item.path in set(listed)]
    for violation in all_found:
        print(violation)
    counts: dict[str, int] = defaultdict(int)
    for violation in all_found:
        counts[re.sub(r"'.*' |\d+ ", "", violation.rule)] += 1
    print(", ".join(f"{count} {rule}" for rule, count in sorted(counts.items())) or "no violations")
    return int(bool(all_found))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
