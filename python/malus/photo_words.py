"""The words with which the report names the figures of photographs and sweep in quality.json."""

#: Section of quality.json → path below it → words. Words that end in [%] are for shares, which the report shows as percent.
#: Figures for programmers only are not listed here; they are in quality.json.
WORDS = {
    "photogrammetry": {
        "program": "program",
        "photos": "photos given",
        "registered": "photos whose place was found",
        "self_calibrated": "lens found from the photos",
        "points": "points that were found in several photos",
        "reprojection_px": "distance of these points from where the photos show them, mean [px]",
        "relief": "depth of these points, of their extent [%]",
        "windows.points": "points that were matched more finely, by windows",
        "windows.matches_a_point": "photos that show one of these, mean",
        "windows.rms_before_px": "distance of these from where the photos show them, before, RMS [px]",
        "windows.rms_after_px": "the same after it, RMS [px]",
        "station.matches": "matches of the polarized image with the photos",
        "station.photos_matched": "photos that the polarized image matches",
        "station.points_seen": "points that the polarized image shows",
        "station.lens": "lens of the polarized image",
    },
    "sweep": {
        "views": "photos used",
        "masks": "images with a mask",
        "completeness": "part of the object where a depth was found [%]",
        "highlights": "part of the object left out because it shines [%]",
        "score": "agreement of the photos, median (1 = alike)",
        "sigma_gsd": "standard deviation of the depth, median [GSD]",
        "first.completeness": "first sweep: part of the object where a depth was found [%]",
        "first.sigma_gsd": "first sweep: standard deviation of the depth, median [GSD]",
    },
}
