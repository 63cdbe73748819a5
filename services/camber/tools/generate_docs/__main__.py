"""`python -m camber.tools.generate_docs [--check]`: write everything in the pages that is generated from the code."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from camber.schemas.channels import ROS2, SENSORS, SERVICES
from camber.tools.generate_docs import data_flow
from camber.tools.generate_docs.decision_pages import decision_list
from camber.tools.generate_docs.decision_table import decision_table
from camber.tools.generate_docs.promises import promise_tables
from camber.tools.generate_docs.service_tables import issues_by_service, parameter_table, runbook_rows
from camber.tools.security.access import table_text

DOCS = Path(__file__).parents[4] / "docs"

SECTIONS: dict[tuple[str, str], Callable[[], str]] = {
    **{
        (f"services/{service}.md", "parameters"): partial(parameter_table, service)
        for service in (*SERVICES, SENSORS)
    },
    ("ros.md", "parameters"): partial(parameter_table, ROS2),
    ("services/integrity.md", "decision table"): decision_table,
    ("decisions/README.md", "decisions"): partial(decision_list, DOCS / "decisions"),
    ("security.md", "access table"): table_text,
    ("safety/promises.md", "promises"): partial(promise_tables, DOCS / "safety" / "promises.toml"),
    **{
        ("runbook.md", f"issues of {service}"): partial(runbook_rows, service)
        for service in issues_by_service()
    },
}
"""Page and name of a section → its text. It replaces what is between `<!-- generated: NAME -->` and the end mark."""


def main(argv: list[str] | None = None) -> int:
    """Write the pages, or with `--check` report which are not current; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m camber.tools.generate_docs", description=__doc__)
    add = parser.add_argument
    add("--check", action="store_true", help="fail where a page is not current; write nothing")
    add("--docs", type=Path, default=DOCS, help="folder of the pages")
    args = parser.parse_args(argv)
    current = pages(args.docs)
    outdated = [
        path for path, text in current.items() if not path.is_file() or path.read_text("utf-8") != text
    ]
    for path in outdated:
        if args.check:
            print(f"{path}: not current, run `make docs`", file=sys.stderr)
        else:
            path.write_text(current[path], encoding="utf-8")
    return int(args.check and bool(outdated))


def pages(docs: Path) -> dict[Path, str]:
    """Return each page that has generated parts, with its text as it should be."""
    names = {"data-flow.md", *(page for page, _ in SECTIONS)}
    return {docs / name: text_of(docs / name, docs) for name in sorted(names)}


def text_of(path: Path, docs: Path) -> str:
    """Return a page with all its generated parts renewed; ValueError names a section whose marks are missing."""
    name = path.relative_to(docs).as_posix()
    if name == "data-flow.md":
        return data_flow.page()
    text = path.read_text("utf-8")
    for (page, section), generate in SECTIONS.items():
        if page != name:
            continue
        begin, end = f"<!-- generated: {section} -->\n", "<!-- end generated -->"
        before, has_begin, rest = text.partition(begin)
        _, has_end, after = rest.partition(end)
        if not (has_begin and has_end):
            raise ValueError(f"{path}: expected a section {begin.strip()} … {end}")
        text = f"{before}{begin}\n{generate()}\n\n{end}{after}"
    return text


if __name__ == "__main__":
    raise SystemExit(main())
