"""Deduplication of uploads: one that came before with the same content is a duplicate and is not counted again.

An upload is known by vehicle, kind and id, and compared by the digest that the store's ledger keeps of its content.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

from camber.map_update.admission import Refusal
from camber.map_update.contribution import Contribution

RefusalCheck = Callable[[Contribution], Refusal | None]


class Outcome(NamedTuple):
    """Result of one contribution; `refusal` is the reason of `refused`."""

    status: Literal["stored", "duplicate", "refused"]
    refusal: Refusal | None = None


def deduplicate(
    contributions: Sequence[Contribution],
    known: Mapping[tuple[str, str, str], bytes],
    refusal_of: RefusalCheck,
) -> tuple[list[Outcome], list[Contribution]]:
    """Return the outcome of each contribution, given the ledger's digests `known`, and the contributions to store."""
    digests = dict(known)
    new: dict[tuple[str, str, str], Contribution] = {}
    outcomes = []
    for contribution in contributions:
        name = contribution.name
        if name in new and name not in digests:
            digests[name] = new[name].digest()
        refusal: Refusal | None = None
        if name in digests:
            if digests[name] == contribution.digest():
                outcomes.append(Outcome("duplicate"))
                continue
            text = f"{contribution.kind} {contribution.id}: other contents are stored under this id"
            refusal = Refusal("id_reused", text)
        refusal = refusal or refusal_of(contribution)
        if refusal is not None:
            outcomes.append(Outcome("refused", refusal))
            continue
        new[name] = contribution
        outcomes.append(Outcome("stored"))
    return outcomes, list(new.values())
