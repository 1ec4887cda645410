"""Package im_pnt_analysis."""

from setuptools import find_packages, setup

setup(
    name="im_pnt_analysis",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_pnt_analysis"]),
        ("share/im_pnt_analysis", ["package.xml"]),
    ],
    install_requires=[
        "setuptools",
        "im_bag",
        "im_core",
        "im_pnt",
        "matplotlib",
        "numpy",
        "pydantic",
        "pyyaml",
        "scipy",
        "z3-solver",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Analysis of Petri net transducers: verification, structure, timed nets, simulation, the command pnt",
    license="MIT",
    entry_points={
        "console_scripts": [
            "pnt = im_pnt_analysis.cli:main",
        ],
    },
)
