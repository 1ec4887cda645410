"""The Data Object Manager: globally available data, each object with its validity."""

from setuptools import find_packages, setup

setup(
    name="im_dom",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_dom"]),
        ("share/im_dom", ["package.xml"]),
    ],
    install_requires=["setuptools", "im_core", "pydantic"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="The Data Object Manager: globally available data, each object with its validity.",
    license="MIT",
    entry_points={
        "console_scripts": ["dom = im_dom.ros.node:main"],
    },
)
