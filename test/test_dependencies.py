"""The page of the dependencies names every package of the lock; the lock has hashes of all that is installed."""

import importlib.metadata
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LOCK = (ROOT / "requirements.lock").read_text()
PACKAGES = re.findall(r"^\S.*?(?=^\S|\Z)", LOCK, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def dependencies():
    spec = importlib.util.spec_from_file_location("dependencies", ROOT / "scripts" / "dependencies.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_package_of_the_lock_has_a_version_and_hashes():
    assert len(PACKAGES) > 150
    for package in PACKAGES:
        head, *hashes = re.split(r" \\\n\s+", package.strip())
        assert re.fullmatch(r"[a-z0-9._-]+==[^ ]+", head), head
        assert hashes, head
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", each) for each in hashes), head


def test_the_lock_has_whatever_its_packages_need(dependencies):
    """What is needed and not locked would be refused, or installed in any version."""
    assert not set(dependencies.users()) - set(dependencies.locked()) - {"pip"}


def test_every_package_has_a_row_and_each_wheel_of_ros_a_name(dependencies):
    text = dependencies.PAGE.read_text()
    for name in dependencies.locked():
        assert (f"`{name}`" if name.startswith("ros-") else f"\n| {name} | ") in text, name


def test_the_table_is_what_the_packages_say(dependencies):
    missing = [name for name in dependencies.locked() if not list(importlib.metadata.distributions(name=name))]
    if missing:
        pytest.skip(f"{len(missing)} packages are those of the ROS that is sourced")
    text = dependencies.PAGE.read_text()
    assert dependencies.page(text) == text, "run scripts/dependencies.py"


def test_every_reason_is_of_a_package_that_is_named(dependencies):
    named = set(re.findall(r"^([A-Za-z0-9_-]+)", (ROOT / "requirements.in").read_text(), re.MULTILINE))
    named = {name.lower().replace("_", "-") for name in named if not name.startswith("ros-")}
    assert set(dependencies.WHY) == named
