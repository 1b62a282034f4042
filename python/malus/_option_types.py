"""Types of all options. Made by scripts/option_types.py from the list in the library; do not edit."""

from __future__ import annotations

from typing import Literal, TypedDict

from malus._section import Section


class CaptureSection(Section):
    """Options of the section capture."""

    registration: Literal["auto", "on", "off"]
    """move the images until they lie on the first one: auto = where they do not lie there already, on = always, off = never"""
    keep_below_px: float
    """registration = auto: images that lie closer than this are left as they are, in px"""
    saturation: float
    """fraction of the white level from which a pixel is saturated"""
    interpolation: Literal["bicubic", "keys"]
    """interpolation of the images when they are registered and resampled: bicubic as OpenCV's (a = -0.75) or keys (a = -0.5)"""
    fine_sigma_px: float
    """registration compares images after a band-pass filter: standard deviation of its finer Gaussian, in px"""
    coarse_sigma_px: float
    """standard deviation of the coarser Gaussian of registration's band-pass filter, in px"""
    cauchy_scale: float
    """disagreement between images, in units of the noise, that halves a pixel's weight"""
    max_iterations: int
    """registration: largest number of Gauss-Newton steps at each level of the image pyramid"""
    max_shift: float
    """registration: a larger displacement counts as a failure; share of the image width"""
    max_uncertainty_px: float
    """registration: a displacement with a larger standard deviation counts as not found, in px"""


class CaptureValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    registration: Literal["auto", "on", "off"]
    keep_below_px: float
    saturation: float
    interpolation: Literal["bicubic", "keys"]
    fine_sigma_px: float
    coarse_sigma_px: float
    cauchy_scale: float
    max_iterations: int
    max_shift: float
    max_uncertainty_px: float


class PolarizationSection(Section):
    """Options of the section polarization."""

    weighting: Literal["uniform", "noise"]
    """weights of the images when the sinusoid is fitted: by their noise, or all alike"""
    recover_outliers: bool
    """where a pixel does not fit, try it without one image (needs five or more)"""
    misfit_sigmas: float
    """a pixel does not follow the sinusoid if its residual exceeds this many standard deviations of the noise and misfit_fraction"""
    misfit_fraction: float
    """a pixel does not follow the sinusoid if its residual exceeds this share of its intensity and misfit_sigmas"""
    dark_sigmas: float
    """a pixel is dark below this many standard deviations of the noise without light"""
    max_condition: float
    """largest condition number of the normal equations of the angle set"""


class PolarizationValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    weighting: Literal["uniform", "noise"]
    recover_outliers: bool
    misfit_sigmas: float
    misfit_fraction: float
    dark_sigmas: float
    max_condition: float


class PolarizerSection(Section):
    """Options of the section polarizer."""

    calibrate_angles: Literal["auto", "on", "off"]
    """find the polarizer's angles and the exposures from the images themselves: auto = only where that fits clearly better than what the station says"""
    angle_sigma_deg: float
    """how far an angle that was read off the polarizer's scale is usually wrong (standard deviation), in degrees"""
    zero_sigma_deg: float
    """standard deviation of the zero of the polarizer's scale, which all angles share"""
    gain_sigma: float
    """standard deviation of the exposure from image to image"""
    min_improvement: float
    """auto: share of what the sinusoid's squared residuals have beyond noise that calibrated angles must remove"""
    min_significance: float
    """auto: standard deviations from which an error of the scale's zero is corrected"""
    highlight_deg: float
    """diffuse objects: angle about the mirror direction of the light that says nothing about the zero"""


class PolarizerValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    calibrate_angles: Literal["auto", "on", "off"]
    angle_sigma_deg: float
    zero_sigma_deg: float
    gain_sigma: float
    min_improvement: float
    min_significance: float
    highlight_deg: float


class PhotosSection(Section):
    """Options of the section photos."""

    backend: Literal["auto", "colmap", "pycolmap"]
    """what finds the cameras of the photographs: the program COLMAP, the Python package pycolmap, or auto = the program if it is installed, else the package"""
    max_features: int
    """largest number of features that are taken of a photo"""
    max_side_px: int
    """photographs with a longer side are made smaller before points are looked for that several of them show: a smaller number is faster, a larger one finds more"""
    guided_matching: bool
    """once photos are matched, search along their epipolar lines for further matches"""
    exhaustive_limit: int
    """most photos of which every pair is matched; of more, only photos near each other in their names' order"""
    min_inliers: int
    """fewest matches that make two photos a pair"""
    max_error_px: float
    """points with a larger mean reprojection error (and more than 2.5 times all points') are left out of the last adjustments"""
    match_windows: bool
    """measure the points anew by least-squares matching of windows, and adjust all cameras to that"""
    match_points_a_photo: int
    """match_windows: largest number of points that are measured anew in a photo, those seen in many photos first"""
    match_radius: int
    """radius of the square windows, in px; twice as large, in coarser images, where noise hides the texture"""
    match_range_px: float
    """match_windows: farthest that a window may end from where its point is expected, in px"""
    match_min_correlation: float
    """match_windows: windows with a lower correlation are left out"""
    match_floor_px: float
    """match_windows: smallest standard deviation that a window's position may have, in px"""
    search_limit_s: int
    """longest search for a first pair, for 20 photos, before the next assumption on the focal length is tried, in s"""
    mark_sigma_px: float
    """standard deviation of a mark in [[scale]], in px"""
    target_sigma_px: float
    """standard deviation of a coded target's center, in px"""
    distance_sigma_relative: float
    """standard deviation of a distance in [[scale]], as a share of it"""


class PhotosValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    backend: Literal["auto", "colmap", "pycolmap"]
    max_features: int
    max_side_px: int
    guided_matching: bool
    exhaustive_limit: int
    min_inliers: int
    max_error_px: float
    match_windows: bool
    match_points_a_photo: int
    match_radius: int
    match_range_px: float
    match_min_correlation: float
    match_floor_px: float
    search_limit_s: int
    mark_sigma_px: float
    target_sigma_px: float
    distance_sigma_relative: float


class SweepSection(Section):
    """Options of the section sweep."""

    station_gamma: float
    """the station's linear intensity is raised to 1 / this, to be coded like the photos; 1 = as it is"""
    window_radius: int
    """radius of the square windows that are compared, in px"""
    known_window_radius: int
    """radius of the windows in a sweep about a known surface, in px; larger, as they lie on that surface"""
    best_views: int
    """number of photos whose match counts at a pixel, the best ones"""
    max_views: int
    """largest number of photos that are compared in one part of the image"""
    min_level_px: int
    """shorter side of the coarsest image, at least, in px"""
    min_points: int
    """fewest triangulated points on the object"""
    noise: float
    """standard deviation of the photos' noise, as a share of white"""
    min_parallax: float
    """photos with less parallax than this, of the photos' median, are left out if others suffice"""
    max_angle_deg: float
    """largest angle between a photo's view and the station's"""
    max_search: int
    """farthest offset from the triangulated points' surface, in px of the coarsest image"""
    small_step: float
    """penalty of neighbors one offset apart, in correlation"""
    large_step: float
    """penalty of neighbors farther apart, in correlation"""
    min_score: float
    """lowest mean correlation of a pixel that is kept"""
    min_agreement: float
    """share of the pixels around it at which the two halves of the photos must agree for a pixel to be kept"""
    min_region_px: int
    """fewest connected pixels that are kept: what agrees by chance comes in small regions"""
    sigma_scale: float
    """factor from half the difference of the two halves' depths to the standard deviation of depth"""
    sigma_floor_gsd: float
    """smallest standard deviation that a swept depth may have, in GSD"""
    again: bool
    """measure the surface in the photographs a second time, close to the fused one, and fuse with that; where they agree on too little, what the fused surface contradicts is left out instead"""


class SweepValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    station_gamma: float
    window_radius: int
    known_window_radius: int
    best_views: int
    max_views: int
    min_level_px: int
    min_points: int
    noise: float
    min_parallax: float
    max_angle_deg: float
    max_search: int
    small_step: float
    large_step: float
    min_score: float
    min_agreement: float
    min_region_px: int
    sigma_scale: float
    sigma_floor_gsd: float
    again: bool


class PriorSection(Section):
    """Options of the section prior."""

    sigma: float | Literal["auto"]
    """standard deviation of a cloud's points, or of the depth of another prior, in the station's unit; left out = the station file's, and without it a cloud's is measured and another's is raster_sigma_gsd"""
    smoothing_px: float | Literal["auto"]
    """over how many pixels a cloud is smoothed: more takes away more of its noise, less keeps more of its detail; auto = as its noise and its density ask for"""
    smoothing_scale: float
    """the estimated smoothing length times this; below 1 because what is smoothed away is lost to the fusion, noise is not"""
    edge_tolerance: float
    """bending, over what is usual, at which the smoothing gives way to a step or an occluding edge"""
    keep_raised: bool
    """whether points that stand out together are kept as a part of the surface; strays never are"""
    neighbors: int
    """number of nearest neighbors, in the image, that a point of the cloud is compared with"""
    outlier_tolerance: float
    """a point is an outlier if it is farther from the median depth of its neighbors, in their robust standard deviations"""
    outlier_floor_gsd: float
    """distance from the median depth of its neighbors that makes no point an outlier, in GSD"""
    max_slope_deg: float
    """steepest slope of a visible surface; points farther behind their neighbors are hidden"""
    min_points: int
    """fewest visible points on the object"""
    raster_sigma_gsd: float
    """standard deviation of a mesh's or a depth map's depth, in GSD, where none is stated"""
    correlated_noise: float
    """share of a point's noise that its neighbors have too, so that smoothing leaves it (for sigma)"""
    tension_spacings: float
    """distance from all points, in point spacings, beyond which the surface levels out to the plane of the cloud"""
    hole_slope: float
    """standard deviation of the slope where a swept depth map has none: what stereo does not see, such as the ridge of a highlight, need not go on as its surroundings do"""
    max_unknowns: int
    """largest smoothing system solved at once; larger rasters are solved in overlapping tiles"""
    sigma_samples: int
    """number of random draws from which the prior's standard deviation is estimated"""


class PriorValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    sigma: float | Literal["auto"]
    smoothing_px: float | Literal["auto"]
    smoothing_scale: float
    edge_tolerance: float
    keep_raised: bool
    neighbors: int
    outlier_tolerance: float
    outlier_floor_gsd: float
    max_slope_deg: float
    min_points: int
    raster_sigma_gsd: float
    correlated_noise: float
    tension_spacings: float
    hole_slope: float
    max_unknowns: int
    sigma_samples: int


class EvidenceSection(Section):
    """Options of the section evidence."""

    refuse: bool
    """end the run where an input is certainly wrong; false: go on, and say that the result has low confidence"""


class EvidenceValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    refuse: bool


class ReflectionSection(Section):
    """Options of the section reflection."""

    region_px: int
    """auto: side of the cells whose pooled azimuth test decides between diffuse and specular"""
    region_strength: float
    """auto: mean sin² of the zenith a region needs to weigh as much as the whole object"""
    beyond_diffuse_share: float
    """auto without a prior: specular if more of the pixels exceed the largest diffuse degree"""


class ReflectionValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    region_px: int
    region_strength: float
    beyond_diffuse_share: float


class LightSection(Section):
    """Options of the section light."""

    model: Literal["directional", "first_order"]
    """the light: from one direction, or with a constant part from everywhere"""
    without_prior: Literal["contour", "convex"]
    """what tells a bump from a hollow where there is neither a prior nor [optics] light: the object's outline, or that it is convex in the whole"""
    iterations: int
    """rounds of the robust fit of the light"""
    outlier_scale: float
    """residual, in robust standard deviations, at which a pixel has half its weight"""
    max_condition: float
    """largest condition number of the normal equations; above it the normals vary too little"""
    min_tangential: float
    """sine of the smallest angle between light and view; below it shading does not tell slopes apart"""
    max_samples: int
    """pixels used; larger images are sampled regularly"""


class LightValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    model: Literal["directional", "first_order"]
    without_prior: Literal["contour", "convex"]
    iterations: int
    outlier_scale: float
    max_condition: float
    min_tangential: float
    max_samples: int


class HeightSection(Section):
    """Options of the section height."""

    method: Literal["likelihood", "linear", "literal"]
    """equations of the height: Gauss-Newton on the likelihood, the linear system, or the paper's rows as printed"""
    perspective: bool
    """metric perspective form; false = orthographic as printed"""
    smoothness: float
    """weight of the height's second differences, which smooths it"""
    boundary: Literal["natural", "prior"]
    """height at the border of the object"""
    boundary_weight: float
    """weight of the prior's height at the border, per pixel"""
    iterations: int
    """largest number of Gauss-Newton steps of the height"""
    tolerance: float
    """the Gauss-Newton steps end when the slopes change by less than this (RMS)"""
    shading_error: float | Literal["auto"]
    """standard deviation of the shading model, share of the intensity; auto = from the fit of the light"""
    stokes_error: float
    """standard deviation of the polarization model, share of the intensity"""
    damping: float
    """weight of the change of the slope in one Gauss-Newton step; holds slopes that nothing determines"""
    outlier_scale: float
    """residual of a pixel, in standard deviations, at which it has half its weight"""


class HeightValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    method: Literal["likelihood", "linear", "literal"]
    perspective: bool
    smoothness: float
    boundary: Literal["natural", "prior"]
    boundary_weight: float
    iterations: int
    tolerance: float
    shading_error: float | Literal["auto"]
    stokes_error: float
    damping: float
    outlier_scale: float


class GridSection(Section):
    """Options of the section grid."""

    grid_px: int
    """distance of the grid's nodes"""
    sigma_nodes: float
    """Gaussian on the grid, standard deviation in nodes"""
    unit_scaling: bool
    """scale both surfaces to 0 … 1 before combining them, as printed; loses the metric relation of their scales"""


class GridValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    grid_px: int
    sigma_nodes: float
    unit_scaling: bool


class OptimizeSection(Section):
    """Options of the section optimize."""

    enabled: bool
    """grid fusion: optimize the fused surface by all equations together"""
    phase_weight: float
    """how much the directions of slopes count that the polarization shows"""
    shading_weight: float
    """how much the slopes count that the brightness shows"""
    zenith_weight: float
    """how much the steepness counts that the degree of polarization shows"""
    prior_weight: float
    """how much the difference to the prior counts, mean over a cell of the grid, in GSD"""
    iterations: int
    """largest number of steps in a tile"""


class OptimizeValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    enabled: bool
    phase_weight: float
    shading_weight: float
    zenith_weight: float
    prior_weight: float
    iterations: int


class RefineSection(Section):
    """Options of the section refine."""

    iterations: int
    """rounds; each fits the reflection, weighs the residuals and solves for the surface"""
    surroundings_iterations: int
    """rounds where a map of the surroundings is fitted, of one step each: map and surface find each other slowly"""
    fine_iterations: int
    """rounds at full resolution after those at half the resolution"""
    coarsest_px: float
    """where a search is worth it, objects are refined at half the resolution first, down to this width and height, in px"""
    more_iterations: int
    """largest number of further rounds at the end, while the surface still moves by more than 0.5 GSD"""
    steps: int
    """Gauss-Newton steps in each round; the first two rounds take one"""
    tile_px: int
    """largest side of a tile without its margins, in px"""
    margin_px: int
    """margin by which a tile overlaps its neighbors, in px"""
    strip_megapixels: float
    """size of the strips of whole rows of tiles that are worked on one after the other; memory grows with it"""
    robust_scale: float
    """residual of the polarization, in standard deviations, at which a pixel has half its weight"""
    graduation: float
    """robust_scale is this many times larger for specular regions in the first round; the factor is halved every round"""
    relative_error: float
    """error of the reflection model as a share of s0"""
    slope_error: float
    """error of the reflection model, as an error of the slope"""
    prior_weight: float
    """how strongly the surface is held to the coarse one where that is uncertain: more stays closer to it, less believes the polarization more (weight of the mean of 8 x 8 pixels, in 1 / GSD)"""
    good_prior_weight: float
    """weight of the prior's mean over a block of 8 x 8 pixels, in 1 / GSD, where the prior's sigma is small"""
    prior_robust_gsd: float
    """distance from the prior, in GSD, at which the prior has half its weight"""
    albedo_weight: float
    """weight of changes of albedo in diffuse regions; up to 2.5 times that where albedo varies little"""
    albedo_contrast: float
    """step of ln albedo between neighboring pixels at which it has half its weight"""
    smoothness: float
    """weight of the second differences of the change to the prior, where all that is wrong with the polarization is noise; less by the share of other errors"""
    search_sharpening: float
    """factor on the prior's detail that the search for a better minimum starts with"""
    search: bool
    """where regions are specular: solve from a second start, too, and keep the better regions of both"""
    environment: bool
    """let diffuse regions mirror smooth surroundings, whose light is fitted"""
    lobe: bool
    """let diffuse regions have the highlight of one small source, which is fitted"""
    regional_weights: bool
    """give less weight to regions that fit badly, such as cast shadows"""
    surroundings: bool
    """fit a map of the surroundings that a matte or glossy object mirrors, where that explains more of the polarization"""
    correct_index: bool
    """replace a refractive index that the polarization clearly contradicts"""
    evidence: bool
    """keep the prior's surface where the reflection model does not explain the polarization"""
    explained_least: float
    """the prior's surface is kept where the model explains no more than this share of the polarization at the prior's slopes; with a map of the surroundings other limits hold"""
    explained_enough: float
    """the refined surface is kept where the model explains at least this share of the polarization at the prior's slopes"""
    anchor: float
    """the prior's low frequencies are kept beyond this times the square root of its points' noise (GSD) times their distance (px), in px; 0 = not"""


class RefineValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    iterations: int
    surroundings_iterations: int
    fine_iterations: int
    coarsest_px: float
    more_iterations: int
    steps: int
    tile_px: int
    margin_px: int
    strip_megapixels: float
    robust_scale: float
    graduation: float
    relative_error: float
    slope_error: float
    prior_weight: float
    good_prior_weight: float
    prior_robust_gsd: float
    albedo_weight: float
    albedo_contrast: float
    smoothness: float
    search_sharpening: float
    search: bool
    environment: bool
    lobe: bool
    regional_weights: bool
    surroundings: bool
    correct_index: bool
    evidence: bool
    explained_least: float
    explained_enough: float
    anchor: float


class SurfaceSection(Section):
    """Options of the section surface."""

    subsample: int
    """only every n-th pixel, across and down, becomes a vertex of the mesh: 2 makes a quarter of the triangles"""
    max_incidence_deg: float
    """triangles seen flatter than this (normal to viewing ray) are left out: the sides of depth steps"""
    min_step_gsd: float
    """depth steps between neighboring pixels up to this many GSD are never cut by step_ratio"""
    step_ratio: float
    """a larger step is cut if it exceeds this many times the steps right before and after it"""
    max_sigma_gsd: float
    """the mesh ends where the standard deviation of depth exceeds this many GSD: ragged rims, and guesses"""
    white_percentile: float
    """intensity percentile that becomes white in the vertex colors"""
    dem_pixel: float | Literal["auto"]
    """side of a pixel of the elevation model (dem.tif), in the station's unit; auto = as fine as the mesh"""
    glb_triangles: int
    """surface.glb takes every n-th pixel as a vertex, n so large that it has about as many triangles at most"""
    glb_texture_px: int
    """longest side of the texture in surface.glb; larger images are reduced by averaging"""


class SurfaceValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    subsample: int
    max_incidence_deg: float
    min_step_gsd: float
    step_ratio: float
    max_sigma_gsd: float
    white_percentile: float
    dem_pixel: float | Literal["auto"]
    glb_triangles: int
    glb_texture_px: int


class AssessSection(Section):
    """Options of the section assess."""

    polarization_height: bool
    """solve for zenith and height of the polarization alone, to show beside the surface; grid fusion needs them"""
    detail_sigma_px: float
    """Gaussian that separates detail (what it removes) from low frequencies"""
    histogram_bins: int
    """classes of the distance histograms; 0 = as wide as the distances' spread and number ask for"""
    histogram_range_gsd: float | Literal["auto"]
    """histograms span plus and minus this; auto = what the distances span, without far ones"""
    sigma_limit_gsd: float
    """pixels with a larger standard deviation of depth count as uncertain"""
    profile_step_px: float
    """largest distance between the samples of a profile, in px"""
    alignment: Literal["none", "rigid", "similarity"]
    """move the surface onto the reference before they are compared: rigid = shift and turn it, similarity = change its size, too, none = leave it where it is"""
    max_distance_gsd: float
    """points farther from the reference than this are not compared"""
    reference_neighbors: int
    """number of points of a reference cloud to which its local plane is fitted"""


class AssessValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    polarization_height: bool
    detail_sigma_px: float
    histogram_bins: int
    histogram_range_gsd: float | Literal["auto"]
    sigma_limit_gsd: float
    profile_step_px: float
    alignment: Literal["none", "rigid", "similarity"]
    max_distance_gsd: float
    reference_neighbors: int


class Values(TypedDict, total=False):
    """Options by section."""

    capture: CaptureValues
    polarization: PolarizationValues
    polarizer: PolarizerValues
    photos: PhotosValues
    sweep: SweepValues
    prior: PriorValues
    evidence: EvidenceValues
    reflection: ReflectionValues
    light: LightValues
    height: HeightValues
    grid: GridValues
    optimize: OptimizeValues
    refine: RefineValues
    surface: SurfaceValues
    assess: AssessValues


class Sections:
    """Attributes of `malus.Options`."""

    capture: CaptureSection
    polarization: PolarizationSection
    polarizer: PolarizerSection
    photos: PhotosSection
    sweep: SweepSection
    prior: PriorSection
    evidence: EvidenceSection
    reflection: ReflectionSection
    light: LightSection
    height: HeightSection
    grid: GridSection
    optimize: OptimizeSection
    refine: RefineSection
    surface: SurfaceSection
    assess: AssessSection
