"""Package of the Motion Control System."""

from setuptools import find_packages, setup

PACKAGE = "im_mcs"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["config/*.yaml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Motion Control System of an intelligent machine",
    license="MIT",
    entry_points={
        "console_scripts": [
            "mcs = im_mcs.ros.launch:main",
            "poses = im_mcs.poses.command:main",
            "model = im_mcs.model.command:main",
            "cell = im_mcs.cell.command:main",
        ]
    },
)
