"""The table of verdicts: every rule by which the integrity judge decides on a fix, in its order."""

from __future__ import annotations

from camber.integrity.checks.fix_sequence import ARRIVAL_CHECKS
from camber.integrity.decision_table import TEST_RULES


def decision_table() -> str:
    """Return the Markdown table of the rules; the first one that applies is the verdict."""
    rows = [f"| {check.explanation} | unknown | `{check.reason}` |" for check in ARRIVAL_CHECKS]
    rows += [
        f"| {rule.explanation} | {rule.outcome.replace('_', ' ')} | `{rule.reason}` |" for rule in TEST_RULES
    ]
    return "\n".join(["| condition | verdict | reason |", "|---|---|---|", *rows])
