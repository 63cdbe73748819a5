"""Print the requirements that pyproject.toml names, so that an image layer holds them apart from the source.

usage: requirements.py pyproject.toml least|whole|compiled
       requirements.py pyproject.toml EXTRA,EXTRA… KIND

least: what every process of Camber imports; whole: what the distribution asks for beyond that; compiled: the compiler,
which several extras ask for; extras: what they ask for beyond all these, in an image of that kind.
"""

import re
import sys
import tomllib
from pathlib import Path

NOT_IN_LEAST = {"argcomplete", "cryptography", "mcap", "pynmeagps", "pyserial", "tqdm", "zstandard"}
"""Of all dependencies those that judge and router do not import."""
COMPILER = "numba"


def name_of(requirement: str) -> str:
    """The distribution that a requirement names."""
    return re.split(r"[^A-Za-z0-9_.-]", requirement, maxsplit=1)[0]


path, what, *kind = Path(sys.argv[1]), *sys.argv[2:]
project = tomllib.loads(path.read_text("utf-8"))["project"]
extras = project["optional-dependencies"]
everyone = project["dependencies"]
compiler = [line for lines in extras.values() for line in lines if name_of(line) == COMPILER]
if gone := NOT_IN_LEAST - {name_of(line) for line in everyone}:
    raise SystemExit(
        f"{path}: no dependency {', '.join(sorted(gone))}, which {Path(__file__).name} leaves out"
    )
layers = {
    "least": [line for line in everyone if name_of(line) not in NOT_IN_LEAST],
    "whole": [line for line in everyone if name_of(line) in NOT_IN_LEAST],
    "compiled": list(dict.fromkeys(compiler)),
}
names = [name for name in what.split(",") if name]
if what not in layers:
    for name in names:
        if name not in extras:
            raise SystemExit(f"{path}: no extra {name!r}, expected some of {', '.join(extras)}")
        if kind != ["compiled"] and any(name_of(line) == COMPILER for line in extras[name]):
            raise SystemExit(f"extra {name} needs {COMPILER}: expected KIND compiled, not {''.join(kind)!r}")
    layers[what] = [line for name in names for line in extras[name] if name_of(line) != COMPILER]
print("\n".join(layers[what]))
