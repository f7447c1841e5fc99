"""Constants of the vehicle that flew: of one that is known by name, or as another description states them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from registry.core import finite
from registry.datasets.crazyflie import CONSTANTS, UNCERTAINTY
from registry.datasets.folder.constants import Constant
from registry.errors import BenchError
from registry.model_file import constants_of
from registry.physics.quadrotor import Quadrotor
from registry.regular_file import read_toml

CRAZYFLIE = "crazyflie"


def vehicle(name: str) -> dict[str, Constant]:
    """The constants of a multirotor.

    Args:
        name: "crazyflie", or the path of a TOML file with a table [physics], such as the dataset.toml of an earlier
            import or a model.toml.

    Raises:
        BenchError: there is no such file, or it states none, or wrong ones.
    """
    if name.lower() == CRAZYFLIE:
        stated = {**CONSTANTS, "pwm_gain": Quadrotor.pwm_gain, "pwm_offset": Quadrotor.pwm_offset}
        return _constants(stated, UNCERTAINTY, "Crazyflie 2")
    path = Path(name)
    table = read_toml(path, f'give "{CRAZYFLIE}" or a TOML file with a table [physics]')
    physics = table.get("physics")
    if not isinstance(physics, dict) or not physics:
        raise BenchError(f"{path} has no table [physics] with the constants of a vehicle: add it.")
    uncertainty = physics.pop("uncertainty", {})
    if not isinstance(uncertainty, dict) or not all(finite(u) and u >= 0 for u in uncertainty.values()):
        raise BenchError(f"{path}: [physics.uncertainty] must be a table of numbers from 0.")
    physics = constants_of(f"{path} [physics]", Quadrotor().parameters(), physics)
    return _constants(physics, uncertainty, f"from {path.name}")


def _constants(values: Mapping[str, Any], uncertainty: Mapping[str, float], origin: str) -> dict[str, Constant]:
    return {name: Constant(_lists(value), origin, uncertainty.get(name)) for name, value in values.items()}


def _lists(value: Any) -> Any:
    return [_lists(v) for v in value] if isinstance(value, tuple) else value
