"""Client of the Intelligent Machine"""

from setuptools import find_packages, setup

setup(
    name="im",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"im": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im"]),
        ("share/im", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Client of the Intelligent Machine",
    license="MIT",
)
