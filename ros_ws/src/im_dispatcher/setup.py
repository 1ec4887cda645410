"""The Dispatcher: commands of the Organization Level become nets of transitions."""

from setuptools import find_packages, setup

setup(
    name="im_dispatcher",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"im_dispatcher": ["nets/*.yaml", "nets/parts/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_dispatcher"]),
        ("share/im_dispatcher", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="The Dispatcher: commands of the Organization Level become nets of transitions.",
    license="MIT",
    entry_points={
        "console_scripts": [
            "dispatcher=im_dispatcher.ros.node:main",
        ],
        "im_pnt.resources": ["cell = im_dispatcher.cell.needs:cell_resources"],
    },
)
