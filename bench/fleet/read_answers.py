"""From stored files, or the lack of them, to answers."""

from collections.abc import Mapping
from typing import Any

from bench.diagnose.report.output_folder import PAGE
from bench.diagnose.report.phrases import gathered
from bench.diagnose.result import DataProblem
from bench.fleet.members import Member
from bench.fleet.result import FAILED, Answer, ErrorBetween, Number
from bench.fleet.stored import VEHICLES, Stored


def failed(member: Member, sentence: str) -> Answer:
    """Where there is no diagnosis."""
    return Answer(member.id, member.vehicle, member.date, "", FAILED, sentence, page="")


def answer_of(member: Member, stored: Stored) -> Answer:
    """What was found, as the page, tables and tests need it."""
    told = stored.values
    problems = [DataProblem(**{**p, "rows": tuple(p["rows"]) if p["rows"] else None}) for p in told["data_problems"]]
    stopped = told["verdict"] == "data_problem"
    return Answer(
        id=member.id,
        vehicle=member.vehicle,
        date=member.date,
        system=told["system"],
        verdict=told["verdict"],
        sentence="; ".join(gathered(problems)) if stopped else "",
        page=f"{VEHICLES}/{stored.folder.name}/{PAGE}",
        numbers=tuple(n for e in told["effects"] if not e["forecast_only"] for n in _numbers(e)),
        errors=tuple(_errors(told["error"], told["noise_floor"])),
    )


def _numbers(effect: Mapping[str, Any]) -> list[Number]:
    term = effect.get("term")
    name = f"{term['axis']} ~ {', '.join(term['signals'])}" if term else effect["id"]
    return [
        Number(
            effect=name,
            parameter=parameter,
            value=_float(p["value"]),
            low=_float(p["low"]),
            high=_float(p["high"]),
            unit=p["unit"],
            rivals=tuple(effect["indistinguishable_from"]),
            learned=bool(effect["learned"]),
        )
        for parameter, p in effect["parameters"].items()
    ]


def _errors(by_model: Mapping[str, Any], floor: Mapping[str, Any]) -> list[ErrorBetween]:
    nominal, extended = by_model["nominal"], by_model["extended"]
    return [
        ErrorBetween(
            group=group,
            unit=e["unit"],
            horizon_s=_float(e["horizon_s"]),
            nominal=_float(e["rmse"]),
            extended=_float(extended.get(group, {}).get("rmse")),
            floor=_float(floor.get(group, {}).get("rmse")),
        )
        for group, e in nominal.items()
    ]


def _float(value: float | None) -> float:
    return float("nan") if value is None else float(value)
