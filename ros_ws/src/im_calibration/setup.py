"""Package im_calibration."""

from setuptools import find_packages, setup

setup(
    name="im_calibration",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_calibration"]),
        ("share/im_calibration", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Camera calibration: where cameras are and how they image, with covariance and verdicts",
    license="MIT",
    entry_points={
        "console_scripts": [
            "calibrate_dataset = im_calibration.commands.calibrate_dataset:main",
            "make_dataset = im_calibration.commands.make_dataset:main",
            "next_best_pose = im_calibration.commands.next_best_pose:main",
        ],
    },
)
