from setuptools import find_packages, setup

package_name = "im_pnt"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["schema/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "im_core", "pydantic"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Petri net transducers in execution: nets from YAML and PNML, and executed",
    license="MIT",
)
