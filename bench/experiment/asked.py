"""What is typed after a command that found something: the same data, system and model, as a shell runs it."""

import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Asked:
    """The options of a command that the next ones need again, as the user wrote them; empty: none was given."""

    system: str = ""
    model: str = ""
    """The model.toml that it started from."""
    out: str = ""
    """The folder of what is written."""
    own: tuple[str, ...] = ()
    """Options that `bench diagnose` has and no other step, word by word; `bench data check` is given such as it has."""
    settings: tuple[str, ...] = ()
    """Options of the data set, "gyroscope=true"."""
    exclude: tuple[str, ...] = ()
    """Names of the recordings that are left out."""

    def command(self, name: str, source: str, *more: str) -> str:
        """`bench NAME SOURCE` with its options and ``more`` words, as a shell runs it."""
        model = self.model
        if name == "design":  # it goes out from what a diagnosis wrote
            model = f"{self.out.rstrip('/')}/model.toml" if self.out else ""
        out = self.out if name in ("diagnose", "extend") else ""
        given = {"--system": self.system, "--model": model, "--out": out}
        words = [w for option, value in given.items() if value for w in (option, value)]
        words += [w for setting in self.settings for w in ("--set", setting)]
        words += [w for recording in self.exclude for w in ("--exclude", recording)]
        own = self.own if name in ("diagnose", "data check") else ()
        return shlex.join(["bench", *name.split(), source, *words, *own, *more])
