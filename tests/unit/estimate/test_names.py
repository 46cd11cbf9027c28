"""Public names of the estimation stand for one thing: no module of a package is called as one of its functions."""

from __future__ import annotations

import pkgutil
from types import ModuleType

import pytest

from semlive import estimate
from semlive.estimate import sutton


@pytest.mark.parametrize("package", [estimate, sutton])
def test_no_module_hides_a_function_of_its_package(package: ModuleType) -> None:
    modules = {item.name for item in pkgutil.iter_modules(package.__path__)}
    assert modules
    assert not modules & set(package.__all__)
