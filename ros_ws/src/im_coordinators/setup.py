"""The four Coordinators: motion, gripper, vision and path planning."""

from setuptools import find_packages, setup

setup(
    name="im_coordinators",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"im_coordinators": ["nets/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_coordinators"]),
        ("share/im_coordinators", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="The four Coordinators: motion, gripper, vision and path planning.",
    license="MIT",
    entry_points={
        "console_scripts": [
            "motion_coordinator=im_coordinators.ros.motion:main",
            "gripper_coordinator=im_coordinators.ros.gripper:main",
            "vision_coordinator=im_coordinators.ros.vision:main",
            "path_planning_coordinator=im_coordinators.ros.path_planning:main",
        ],
    },
)
