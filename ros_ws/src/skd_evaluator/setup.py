from glob import glob

from setuptools import find_packages, setup

PACKAGE = "skd_evaluator"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(),
    package_data={
        PACKAGE: [
            "__init__.pyi",
            "py.typed",
            "extensions/campaign/*.yaml",
            "extensions/exchange/templates/*",
            "extensions/protocols/templates/*",
            "report/html/templates/*",
            "metrics/behaviour/walkers.yaml",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*.yaml")),
        (f"share/{PACKAGE}/launch", glob("launch/*.launch.py")),
        (f"share/{PACKAGE}/rviz", glob("rviz/*.rviz")),
        (f"share/{PACKAGE}/foxglove", glob("foxglove/*.json")),
    ],
    install_requires=[
        "setuptools",
        "numpy",
        "scipy",
        "numba",
        "PyYAML",
        "pydantic",
        "matplotlib",
        "rich",
        "mcap",
        "zstandard",
        "rosbags",
        "Jinja2",
        "vl-convert-python",
        "altair",
    ],
    extras_require={"test": ["pytest"]},  # by this colcon knows what `colcon test` is to run
    zip_safe=False,
    description="The judge of the Safe-Kamikaze Distance",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "evaluator = skd_evaluator.start:evaluator",
            "skd = skd_evaluator.start:skd",
        ],
        "skd.commands": [
            "campaign = skd_evaluator.extensions.campaign.command:add_campaign",
            "benchmark = skd_evaluator.extensions.campaign.benchmark:add_benchmark",
            "protocol = skd_evaluator.extensions.protocols.command:add_protocol",
            "fuse = skd_evaluator.extensions.fusion.command:add_fuse",
            "export = skd_evaluator.extensions.exchange.command:add_export",
            "import = skd_evaluator.extensions.exchange.command:add_import",
            "log = skd_evaluator.extensions.log.command:add_log",
        ],
        "skd.checks": [
            "ncap = skd_evaluator.extensions.protocols.result:with_regulator",
        ],
        "skd.report_sections": [
            "ncap = skd_evaluator.extensions.protocols.page:section_of",
        ],
    },
)
