"""What the figures of photographs and sweep in quality.json are called in the report."""

#: Section of quality.json → path below it → words. What is for programmers only is not here; quality.json has it.
WORDS = {
    "photogrammetry": {
        "program": "program",
        "photos": "photos given",
        "registered": "photos whose place was found",
        "self_calibrated": "lens found from the photos",
        "points": "points that were found in several photos",
        "reprojection_px": "their distance from where the photos show them, mean [px]",
        "relief": "depth of these points, as a share of their extent",
        "windows.points": "points that were matched more finely, by windows",
        "windows.matches_a_point": "photos that show such a point, mean",
        "windows.rms_before_px": "their distance in the photos before that, RMS [px]",
        "windows.rms_after_px": "and after, RMS [px]",
        "station.matches": "matches of the polarized image with the photos",
        "station.photos_matched": "photos that it matches",
        "station.points_seen": "of these points, those that it shows",
        "station.lens": "lens of the polarized image",
    },
    "sweep": {
        "views": "photos used",
        "completeness": "share of the object where a depth was found",
        "highlights": "share of the object left out because it shines",
        "score": "agreement of the photos, median (1 = alike)",
        "sigma_gsd": "standard deviation of the depth, median [GSD]",
        "first.completeness": "first sweep: share of the object where a depth was found",
        "first.sigma_gsd": "first sweep: standard deviation of the depth, median [GSD]",
    },
}
