from registry.conformance import EffectConformance
from registry.effects.munk_moment import MunkMoment


class TestMunkMoment(EffectConformance):
    effect = MunkMoment
