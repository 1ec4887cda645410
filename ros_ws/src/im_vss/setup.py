from setuptools import find_packages, setup

package_name = "im_vss"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["config/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="The Vision Services System: cameras, spot finding and camera calibration as vision services.",
    license="MIT",
    entry_points={
        "console_scripts": [
            "recalibrate = im_vss.ros.recalibrate:main",
            "vss = im_vss.ros.launch:main",
            "vss_apart = im_vss.ros.apart:main",
            "vss_run = im_vss.ros.vss_run:main",
        ]
    },
)
