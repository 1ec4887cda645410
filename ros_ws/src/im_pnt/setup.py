from setuptools import find_packages, setup

package_name = "im_pnt"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["display/static/*", "schema/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="im maintainers",
    maintainer_email="maintainers@example.org",
    description="Petri net transducers: nets from YAML, verified, executed, distributed, and drawn live",
    license="MIT",
    entry_points={
        "console_scripts": [
            "pnt = im_pnt.cli:main",
            "pnt_display = im_pnt.ros.display_node:main",
        ],
    },
)
