"""Nets without the machine: the packages of ros_ws/src that need none of it, as one that pip builds once."""

import os
from contextlib import chdir
from itertools import chain

from setuptools import Distribution, setup

from distutils.core import run_setup  # isort: skip  (setuptools brings it)

PACKAGES = ("im_core", "im_bag", "im_pnt", "im_pnt_analysis", "im_dom", "im_pnt_display", "im_pnt_node")
HERE = os.path.dirname(os.path.abspath(__file__))
SOURCES = "../ros_ws/src"


def described(package: str) -> Distribution:
    """Reads the ``setup.py`` of a package."""
    with chdir(os.path.join(HERE, SOURCES, package)):
        return run_setup("setup.py", stop_after="init")


parts = {package: described(package) for package in PACKAGES}
groups = sorted({group for part in parts.values() for group in part.entry_points or ()})
setup(
    name="im_nets",
    version="0.1.0",
    description="Petri net transducers: verified, tested, simulated, drawn and run",
    license="MIT",
    package_dir={package: f"{SOURCES}/{package}/{package}" for package in PACKAGES},
    packages=sorted(chain.from_iterable(part.packages for part in parts.values())),
    package_data={name: files for part in parts.values() for name, files in (part.package_data or {}).items()},
    install_requires=sorted(
        {need for part in parts.values() for need in part.install_requires} - {*PACKAGES, "setuptools"}
    ),
    entry_points={
        group: [entry for part in parts.values() for entry in (part.entry_points or {}).get(group, ())]
        for group in groups
    },
    zip_safe=False,
)
