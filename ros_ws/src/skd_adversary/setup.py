from glob import glob

from setuptools import find_packages, setup

PACKAGE = "skd_adversary"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(),
    package_data={PACKAGE: ["__init__.pyi", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools", "numpy", "scipy", "numba", "scikit-learn"],
    extras_require={"test": ["pytest"]},  # by this colcon knows what `colcon test` is to run
    zip_safe=False,
    description="The adversary of the Safe-Kamikaze Distance",
    license="Apache-2.0",
    entry_points={"console_scripts": ["adversary = skd_sim.start:adversary"]},
)
