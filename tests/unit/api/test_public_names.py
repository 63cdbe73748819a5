"""What `import camber` offers: names that are there, documented, and quick to import."""

import subprocess
import sys

import pytest

import camber


@pytest.mark.parametrize("name", camber.__all__)
def test_each_public_name_is_there_and_documented(name):
    assert getattr(camber, name).__doc__
    assert name in dir(camber)


def test_an_unknown_name_is_named():
    with pytest.raises(AttributeError, match="'camber' has no attribute 'solv'"):
        camber.solv  # noqa: B018


def test_importing_camber_imports_no_more_than_itself():
    code = (
        "import camber, sys; print([n for n in sys.modules if n.startswith(('camber.', 'numpy', 'zenoh'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
