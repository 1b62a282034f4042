"""The coin of rough metal, for which the formulas for dielectrics do not hold."""

from . import coin


def scene(style, rng, quality):
    return coin.scene(style, rng, quality, dict(type="roughconductor", eta=0.25, k=3.4, alpha=0.18))


STYLES = dict(coin.STYLES)
