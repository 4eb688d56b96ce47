"""Packages of the wheel. `conf` and `paper_tables` lie at the top of a checkout and inside `tdgbench` in the wheel."""

from setuptools import find_packages, setup

DATA = {"tdgbench.conf": "conf", "tdgbench.paper_tables": "paper_tables"}

setup(
    packages=[*find_packages(include=["tdgbench*", "methods*"]), *DATA],
    package_dir=DATA,
    package_data={
        "tdgbench": ["py.typed", "templates/*"],
        "methods": ["py.typed"],
        "tdgbench.present": ["*.j2", "*.css", "*.js"],
        "tdgbench.report": ["*.j2", "*.css", "*.js"],
        "tdgbench.compare": ["*.j2"],
        "tdgbench.site": ["*.j2"],
        "tdgbench.view": ["*.j2", "*.js"],
        "tdgbench.conf": ["**/*.yaml"],
        "tdgbench.paper_tables": ["*"],
    },
)
