"""Package of what all of the Intelligent Machine shares."""

from setuptools import find_packages, setup

setup(
    name="im_core",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_core"]),
        ("share/im_core", ["package.xml"]),
    ],
    install_requires=["setuptools", "numpy", "pydantic", "pyyaml"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="What all packages of the Intelligent Machine share",
    license="MIT",
)
