"""Package of the simulated testbed."""

from setuptools import find_packages, setup

setup(
    name="im_sim",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_sim"]),
        ("share/im_sim", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="The simulated testbed",
    license="MIT",
    entry_points={"console_scripts": ["testbed = im_sim.ros.launch:main"]},
)
