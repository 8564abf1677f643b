from glob import glob

from setuptools import find_packages, setup

PACKAGE = "skd_sim"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(),
    package_data={PACKAGE: ["scenarios/*.yaml", "controllers/*.json", "controllers/*.npz", "__init__.pyi", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools", "numpy", "numba", "PyYAML", "pydantic"],
    extras_require={"test": ["pytest"]},  # by this colcon knows what `colcon test` is to run
    zip_safe=False,
    description="The world of the Safe-Kamikaze Distance",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "vehicle_simulator = skd_sim.start:vehicle_simulator",
            "car_controller = skd_sim.start:car_controller",
            "carla_bridge = skd_sim.start:carla_bridge",
        ]
    },
)
