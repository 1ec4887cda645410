"""Package im_pnt_node."""

from setuptools import find_packages, setup

setup(
    name="im_pnt_node",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_pnt_node"]),
        ("share/im_pnt_node", ["package.xml"]),
    ],
    install_requires=["setuptools", "im_bag", "im_core", "im_pnt", "pydantic", "pyyaml"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Nets that talk, last and are ROS nodes: remote places, journal, re-run, node",
    license="MIT",
    entry_points={
        "console_scripts": [
            "pnt_node = im_pnt_node.ros.net_runner:main",
            "strategies = im_pnt_node.ros.strategies:main",
        ],
        "im_pnt.commands": ["journal = im_pnt_node.cli.journal:add", "test = im_pnt_node.cli.scenarios:add"],
        "im_pnt.programs": ["mission = im_pnt_node.ros.rerun:main", "run = im_pnt_node.ros.net_runner:main"],
        "pytest11": ["im_pnt_scenarios = im_pnt_node.scenario.pytest_plugin"],
        "im_pnt.message_types": ["ros = im_pnt_node.ros.messages:RosTypes"],
    },
)
