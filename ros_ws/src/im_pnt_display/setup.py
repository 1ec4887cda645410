"""Package im_pnt_display."""

from setuptools import find_packages, setup

setup(
    name="im_pnt_display",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"im_pnt_display": ["page/static/*", "page/vendor/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_pnt_display"]),
        ("share/im_pnt_display", ["package.xml"]),
    ],
    install_requires=["setuptools", "aiohttp", "im_bag", "im_core", "im_pnt", "im_pnt_analysis", "pydantic"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Drawing of Petri net transducers and the web page that shows and operates the machine.",
    license="MIT",
    entry_points={
        "console_scripts": [
            "pnt_display = im_pnt_display.ros.node:main",
            "view = im_pnt_display.cli:view",
        ],
        "im_pnt.commands": ["display = im_pnt_display.cli:add_display", "draw = im_pnt_display.cli:add"],
        "im_pnt.counterexamples": ["drawings = im_pnt_display.page.messages:drawn_counterexample"],
    },
)
