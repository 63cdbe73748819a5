"""Print the requirements that pyproject.toml names, so that an image layer holds them apart from the source.

usage: requirements.py pyproject.toml [EXTRA,EXTRA…]; without extras what every service needs, with them only theirs.
"""

import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path(sys.argv[1]).read_text("utf-8"))["project"]
extras = [name for name in "".join(sys.argv[2:]).split(",") if name]
known = project["optional-dependencies"]
for name in extras:
    if name not in known:
        raise SystemExit(f"{sys.argv[1]}: no extra {name!r}, expected some of {', '.join(known)}")
wanted = [line for name in extras for line in known[name]] if extras else project["dependencies"]
print("\n".join(wanted))
