"""The package camber_msgs, which people build with colcon: what its files name is what there is."""

from __future__ import annotations

import re
import tomllib
import xml.etree.ElementTree as ElementTree
from importlib.resources import files
from pathlib import Path

from rosbags.typesys import get_types_from_msg

from support.tree import ROOT

PACKAGE = Path(str(files("camber.formats.ros"))) / "msg" / "camber_msgs"
MANIFEST = ElementTree.parse(PACKAGE / "package.xml").getroot()
BUILD = (PACKAGE / "CMakeLists.txt").read_text("utf-8")
NAMES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.glob("msg/*.msg"))
FIELD_NAME = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")
"""ROS 2, "Interface definition": what rosidl takes for a name."""


def generated() -> tuple[list[str], set[str]]:
    """The messages and the dependencies of rosidl_generate_interfaces."""
    match = re.search(
        r"rosidl_generate_interfaces\(\$\{PROJECT_NAME\}(.*?)DEPENDENCIES(.*?)\)", BUILD, re.DOTALL
    )
    assert match is not None
    return re.findall(r'"(\S+)"', match[1]), set(match[2].split())


def packages_of_fields() -> set[str]:
    packages = set()
    for name in NAMES:
        kind = f"camber_msgs/{name.removesuffix('.msg')}"
        for _, fields in get_types_from_msg((PACKAGE / name).read_text("utf-8"), kind).values():
            assert all(FIELD_NAME.fullmatch(field) for field, _ in fields)
            packages |= set(re.findall(r"'(\w+)/msg/", repr(fields)))
    return packages - {"camber_msgs"}


def test_every_message_is_generated_with_the_packages_of_its_fields() -> None:
    messages, packages = generated()
    assert messages == NAMES
    assert "msg/Verdict.msg" in NAMES
    assert packages == packages_of_fields() == {"std_msgs"}
    assert set(re.findall(r"find_package\((\w+) REQUIRED\)", BUILD)) == packages | {
        "ament_cmake", "rosidl_default_generators"
    }  # fmt: skip


def test_the_manifest_has_the_dependencies_of_cmake_and_the_version_of_camber() -> None:
    texts = {tag: {element.text for element in MANIFEST.iter(tag)} for tag in ("depend", "buildtool_depend")}
    assert texts["depend"] == packages_of_fields()
    assert texts["buildtool_depend"] == {"ament_cmake", "rosidl_default_generators"}
    assert MANIFEST.findtext("member_of_group") == "rosidl_interface_packages"
    assert MANIFEST.findtext("name") == "camber_msgs"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert (MANIFEST.findtext("version"), MANIFEST.findtext("license")) == (
        project["version"],
        project["license"],
    )
