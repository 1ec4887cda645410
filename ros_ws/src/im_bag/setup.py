"""Package im_bag."""

from setuptools import find_packages, setup

setup(
    name="im_bag",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_bag"]),
        ("share/im_bag", ["package.xml"]),
    ],
    install_requires=["setuptools", "im_core", "mcap", "numpy", "pyyaml", "rosbags", "zstandard"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Recordings of ROS messages: written, completed, read, played",
    license="MIT",
    entry_points={
        "console_scripts": [
            "foxglove_bridge = im_bag.ros.foxglove_bridge:main",
            "record = im_bag.ros.recorder:main",
            "replay = im_bag.ros.replay:main",
        ],
    },
)
