"""Package im_cell."""

from setuptools import find_packages, setup

setup(
    name="im_cell",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"im_cell": ["cells/*/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_cell"]),
        ("share/im_cell", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="The cell: robot, camera and laser models, calibration files, and the ends of the testbed link.",
    license="MIT",
    entry_points={"im_pnt.parameters": ["cell = im_cell.net_parameters:net_parameters"]},
)
