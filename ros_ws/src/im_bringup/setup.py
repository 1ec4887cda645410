"""Package that brings the Intelligent Machine up, records it and takes it down."""

from glob import glob

from setuptools import find_packages, setup

setup(
    name="im_bringup",
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"im_bringup": ["py.typed", "config/*.*", "deployments/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/im_bringup"]),
        ("share/im_bringup", ["package.xml"]),
        ("share/im_bringup/launch", sorted(glob("launch/*.*"))),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="im maintainers",
    maintainer_email="maintainers@im.invalid",
    description="Deployment, bootstrap, task registry, start and stop of the Intelligent Machine",
    license="MIT",
    entry_points={
        "console_scripts": [
            "action=im_bringup.ros.graph.action:main",
            "agent=im_bringup.ros.agent:main",
            "bootstrap=im_bringup.ros.launch:main",
            "data_objects=im_bringup.ros.data_objects:main",
            "doctor=im_bringup.machine.doctor:main",
            "interfaces=im_bringup.ros.interfaces:main",
            "lifecycle=im_bringup.ros.graph.lifecycle:main",
            "load=im_bringup.ros.net_commands:load",
            "node=im_bringup.ros.graph.node:main",
            "param=im_bringup.ros.graph.parameter:main",
            "recover=im_bringup.ros.recover:main",
            "run=im_core.executables:main",
            "run_command=im_bringup.ros.run_command:main",
            "security=im_bringup.ros.security:main",
            "service=im_bringup.ros.graph.service:main",
            "shared_process=im_bringup.ros.shared_process:main",
            "start=im_bringup.machine.start:main",
            "stop=im_bringup.machine.stop:main",
            "tasks=im_bringup.ros.tasks:main",
            "topic=im_bringup.ros.graph.topic:main",
            "truth_error=im_bringup.ros.truth_error:main",
            "unload=im_bringup.ros.net_commands:unload",
        ],
    },
)
