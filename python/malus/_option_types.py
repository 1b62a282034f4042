"""Types of all options. Made by scripts/option_types.py from the list in the library; do not edit."""

from __future__ import annotations

from typing import Literal, TypedDict

from malus._section import Section


class CaptureSection(Section):
    """Options of the section capture."""

    registration: Literal["auto", "on", "off"]
    """align all images with the first one: auto = only images that are not aligned yet, on = always, off = never"""
    keep_below_px: float
    """registration = auto: images displaced by less than this, or than three times the displacement's own error, stay unchanged, in px"""
    saturation: float
    """fraction of the white level from which a pixel is saturated"""
    fine_sigma_px: float
    """registration compares images after a band-pass filter: standard deviation of its finer Gaussian, in px"""
    coarse_sigma_px: float
    """standard deviation of the coarser Gaussian of registration's band-pass filter, in px"""
    cauchy_scale: float
    """disagreement between images, in units of the noise, that halves a pixel's weight"""
    max_iterations: int
    """registration: largest number of Gauss-Newton steps at each level of the image pyramid"""
    max_shift: float
    """registration: images displaced by more than this share of the image width count as failures"""
    max_uncertainty_px: float
    """registration: a displacement with a larger standard deviation counts as not found, in px"""


class CaptureValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    registration: Literal["auto", "on", "off"]
    keep_below_px: float
    saturation: float
    fine_sigma_px: float
    coarse_sigma_px: float
    cauchy_scale: float
    max_iterations: int
    max_shift: float
    max_uncertainty_px: float


class PolarizationSection(Section):
    """Options of the section polarization."""

    weighting: Literal["uniform", "noise"]
    """weights of the images when the sinusoid is fitted: noise = by their noise, uniform = all alike"""
    recover_outliers: bool
    """fit pixels that do not follow the sinusoid again without their worst image (needs five or more images)"""
    misfit_sigmas: float
    """a pixel does not follow the sinusoid if its residual exceeds both this many standard deviations of the noise and misfit_fraction"""
    misfit_fraction: float
    """a pixel does not follow the sinusoid if its residual exceeds both this share of its intensity and misfit_sigmas"""
    dark_sigmas: float
    """a pixel counts as dark if its intensity is below this many standard deviations of the noise without light"""
    max_condition: float
    """polarizer angles are refused if the condition number of the sinusoid fit exceeds this: they are too close together"""


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
    """find the polarizer's angles and the exposures from the images themselves: auto = only if they fit clearly better than the station's, on = always, off = never"""
    angle_sigma_deg: float
    """standard deviation of each angle that was read off the polarizer's scale, in degrees"""
    zero_sigma_deg: float
    """standard deviation of the zero of the polarizer's scale, which all angles share, in degrees"""
    gain_sigma: float
    """standard deviation of the exposure from image to image, as a share of the exposure"""
    min_improvement: float
    """calibrate_angles = auto: calibrated angles are used if they remove more than this share of the squared residuals' excess over noise"""
    min_significance: float
    """an error of the scale's zero is corrected if it exceeds this many of its standard deviations"""
    highlight_deg: float
    """diffuse objects: normals within this angle of the half vector of light and view, where highlights are, are not used to find the scale's zero, in degrees"""


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
    """largest number of features that are taken from each photo"""
    max_side_px: int
    """photographs with a longer side are reduced to this size before feature points are searched in them, in px: smaller is faster, larger finds more points"""
    guided_matching: bool
    """once photos are matched, search along their epipolar lines for further matches"""
    exhaustive_limit: int
    """up to this many photos, all pairs are matched; with more photos, mainly those close to each other in the order of their names, in which the first follows the last"""
    min_inliers: int
    """two photos with fewer consistent matches do not count as a pair"""
    max_error_px: float
    """image measurements whose reprojection error exceeds both this, in px, and 2.5 times the mean of all points are left out of the last adjustments"""
    match_windows: bool
    """measure the points again by least-squares matching of image windows, and adjust all cameras to these measurements"""
    match_points_a_photo: int
    """match_windows: points are measured again until each photo has this many, those seen in many photos first; a photo may get more where other photos still have too few"""
    match_radius: int
    """match_windows: radius of the square windows, in px; where noise hides the texture, windows of twice this radius are matched in coarser images"""
    match_range_px: float
    """match_windows: windows that end farther than this from their predicted position are left out, in px"""
    match_min_correlation: float
    """match_windows: windows with a lower correlation are left out"""
    match_floor_px: float
    """match_windows: lower limit of the standard deviation of a window's position, in px"""
    search_limit_s: int
    """longest search for a first pair of photos before the next assumed focal length is tried, in s; holds for up to 20 photos and grows in proportion with more"""
    mark_sigma_px: float
    """standard deviation of a mark in [[scale]], in px"""
    target_sigma_px: float
    """standard deviation of a coded target's center, in px"""
    distance_sigma_relative: float
    """standard deviation of a distance in [[scale]], as a share of the distance"""


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
    """the station's linear intensity is raised to the power 1 / this, so that it is coded like the photos; 1 = it stays linear"""
    window_radius: int
    """radius of the square windows that are compared, in px"""
    known_window_radius: int
    """radius of the windows in a sweep about a known surface, in px; larger than window_radius, because these windows lie on that surface"""
    best_views: int
    """number of photos that count at a pixel: the score of a depth is the mean of this many highest correlations"""
    max_views: int
    """largest number of photos that are compared in one part of the image"""
    min_level_px: int
    """smallest length of the shorter side of the coarsest image of the pyramid, in px"""
    min_points: int
    """the sweep ends with an error if fewer triangulated points lie on the object"""
    noise: float
    """standard deviation of the photos' noise, as a share of white"""
    min_parallax: float
    """photos whose parallax is below this share of the photos' median are left out if enough other photos remain (twice best_views)"""
    max_angle_deg: float
    """photos that see the object at a larger angle to the station's view are left out, in degrees"""
    max_search: int
    """largest search distance from the surface of the triangulated points, as parallax in px of the coarsest image"""
    small_step: float
    """penalty where the depths of neighboring pixels differ by one search step, in units of correlation; larger is smoother"""
    large_step: float
    """penalty where the depths of neighboring pixels differ by more than one search step, in units of correlation; larger gives fewer depth jumps"""
    min_score: float
    """pixels with a lower mean correlation get no depth"""
    min_agreement: float
    """the photos are split into two halves; a pixel keeps its depth if both halves agree on at least this share of the pixels around it"""
    min_region_px: int
    """connected regions of fewer pixels are dropped: depths that agree by chance form small regions"""
    sigma_scale: float
    """the standard deviation of depth is this factor times half the RMS difference between the depths from two halves of the photos"""
    sigma_floor_gsd: float
    """smallest standard deviation that a swept depth may have, in GSD"""
    again: bool
    """sweep the photographs a second time, close to the fused surface, and fuse with the new depths; if the first sweep found little, only drop its depths that contradict the fused surface"""


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
    """standard deviation of a cloud's points or of another prior's depth, in the station's unit; auto = from the station file, else measured (cloud) or raster_sigma_gsd (mesh, depth map, cloud that was smoothed); required for a shape"""
    smoothing_px: float | Literal["auto"]
    """length over which a cloud is smoothed, in px: larger removes more noise, smaller keeps more detail; auto = estimated from the cloud's noise and density"""
    smoothing_scale: float
    """factor on the automatic smoothing_px; below 1 because fusion cannot restore detail that was smoothed away, but can reduce noise"""
    edge_tolerance: float
    """bending, as a multiple of what is usual, at which the smoothing is halved: steps and occluding edges stay sharp; larger smooths them more"""
    keep_raised: bool
    """keep points that stand out toward the camera as a part of the surface if many of their neighbors do, too; single points are never kept"""
    neighbors: int
    """number of nearest neighbors, in the image, that a point of the cloud is compared with"""
    outlier_tolerance: float
    """a point is an outlier if its distance from the median depth of its neighbors exceeds both this many robust standard deviations and outlier_floor_gsd"""
    outlier_floor_gsd: float
    """points closer than this to the median depth of their neighbors are never outliers, in GSD"""
    max_slope_deg: float
    """steepest slope that a visible surface can have, in degrees; points that lie deeper behind the points around them count as hidden"""
    min_points: int
    """the run ends with an error if fewer points of the cloud, or pixels of another prior, are visible on the object"""
    raster_sigma_gsd: float
    """standard deviation of a mesh's, a depth map's or a smoothed cloud's depth, in GSD, where none is stated"""
    correlated_noise: float
    """share of a point's noise that its neighbors have in common: smoothing does not reduce it, so it stays in the prior's standard deviation"""
    tension_spacings: float
    """distance from all points, in point spacings, beyond which the surface levels out to the plane of the cloud"""
    hole_slope: float
    """growth of the depth's standard deviation inside holes of the prior, in GSD per px from the rim (in a cloud: beyond two point spacings from the nearest point): unseen parts, such as highlights, may deviate from their surroundings"""
    max_unknowns: int
    """largest number of unknowns of the smoothing that are solved at once; larger rasters are solved in overlapping tiles"""
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
    """[optics] reflection = auto: side of the cells over which azimuths are pooled to decide between diffuse and specular, in px"""
    region_strength: float
    """[optics] reflection = auto: mean sin² of the zenith at which a region's own azimuths count as much as the whole object's; flatter regions follow the whole object"""
    beyond_diffuse_share: float
    """[optics] reflection = auto, no prior: the object is specular if more than this share of its pixels is polarized more strongly than diffuse reflection can be"""


class ReflectionValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    region_px: int
    region_strength: float
    beyond_diffuse_share: float


class LightSection(Section):
    """Options of the section light."""

    model: Literal["directional", "first_order"]
    """model of the light: directional = from one direction, first_order = with an additional constant part from everywhere"""
    without_prior: Literal["contour", "convex"]
    """how bumps are told from hollows if neither a prior nor [optics] light is given: contour = by the object's outline, convex = the object is taken to be convex as a whole"""
    iterations: int
    """rounds of the robust fit of the light"""
    outlier_scale: float
    """residual, in robust standard deviations, at which a pixel has half its weight"""
    max_condition: float
    """largest condition number of the normal equations; above it the normals vary too little to determine the light"""
    min_tangential: float
    """smallest sine of the angle between light and view; below it, shading does not distinguish slopes, and no height is computed"""
    max_samples: int
    """largest number of pixels used; larger images are sampled regularly"""


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
    """how the height is solved: likelihood = Gauss-Newton on the likelihood of the measurements, linear = one linear system, literal = the paper's equations as printed"""
    perspective: bool
    """use the perspective camera and metric heights; false = orthographic, as printed in the paper"""
    smoothness: float
    """weight of the height's second differences; larger is smoother"""
    boundary: Literal["natural", "prior"]
    """height at the border of the object: natural = free, prior = the prior's"""
    boundary_weight: float
    """boundary = prior: weight of the prior's height at the border, per pixel"""
    iterations: int
    """largest number of Gauss-Newton steps of the height"""
    tolerance: float
    """the Gauss-Newton steps end when the slopes change by less than this (RMS)"""
    shading_error: float | Literal["auto"]
    """standard deviation of the shading model's error, as a share of the intensity; auto = from the fit of the light"""
    stokes_error: float
    """standard deviation of the polarization model's error, as a share of the intensity"""
    damping: float
    """weight against changes of the slope in one Gauss-Newton step: larger gives smaller steps and holds slopes that the data do not determine"""
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
    """distance between the grid's nodes, in px"""
    sigma_nodes: float
    """standard deviation of the Gaussian that smooths the grid, in nodes"""
    unit_scaling: bool
    """scale both surfaces to 0 … 1 before combining them, as printed in the paper; loses the metric relation of their scales"""


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
    """weight of the azimuth (direction of slope) that the phase of polarization gives; 0 = ignored"""
    shading_weight: float
    """weight of the shading equation, by which brightness gives the slope; 0 = ignored"""
    zenith_weight: float
    """weight of the zenith (steepness) that the degree of polarization gives; 0 = ignored"""
    prior_weight: float
    """weight of the difference from the prior, averaged over each cell of the grid, in 1 / GSD per pixel; larger stays closer to the prior"""
    iterations: int
    """largest number of solver steps in each tile"""


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
    """number of rounds, of one step each, if a map of the surroundings is fitted: map and surface converge slowly together"""
    fine_iterations: int
    """rounds at full resolution after those at half the resolution; with a map of the surroundings one more"""
    coarsest_px: float
    """if the search runs or a map of the surroundings is fitted, objects are first refined at half the resolution, before that at half of it, and so on, as long as the square root of their number of pixels is at least this (with a map 1.5 times this), in px"""
    more_iterations: int
    """largest number of further rounds at the end, while the surface still moves by more than 0.5 GSD"""
    steps: int
    """Gauss-Newton steps in each round; the first two rounds take one"""
    tile_px: int
    """largest side of a tile without its margins, in px"""
    margin_px: int
    """margin by which a tile overlaps its neighbors, in px"""
    strip_megapixels: float
    """the image is processed in strips of whole rows of tiles of about this many megapixels; larger takes more memory"""
    robust_scale: float
    """residual of the polarization, in standard deviations, at which a pixel has half its weight"""
    graduation: float
    """robust_scale is this many times larger for specular regions in the first round; the factor is halved every round"""
    relative_error: float
    """standard deviation of the reflection model's error, as a share of s0 (the intensity)"""
    slope_error: float
    """standard deviation of the reflection model's error, expressed as an error of the slope"""
    prior_weight: float
    """how strongly the surface is held to the prior where the prior is uncertain: larger stays closer to it, smaller follows the polarization more (weight of the mean of 8 x 8 pixels, in 1 / GSD)"""
    good_prior_weight: float
    """weight of the prior's mean over a block of 8 x 8 pixels, in 1 / GSD, where the prior's sigma is small"""
    prior_robust_gsd: float
    """distance from the prior, in GSD, at which the prior has half its weight"""
    albedo_weight: float
    """weight of albedo differences between neighboring diffuse pixels, up to 2.5 times larger if albedo varies little; larger explains brightness by shape instead of albedo"""
    albedo_contrast: float
    """difference of ln albedo between neighboring pixels at which albedo_weight is halved"""
    smoothness: float
    """weight of the second differences of the change from the prior, times the share of noise in the variance of the polarization; larger is smoother"""
    search_sharpening: float
    """the search's second start is the prior plus this many times its own detail finer than 8 px; 0 = the prior itself, -1 = the prior without that detail"""
    search: bool
    """if much of the object is specular: solve again from a second start, and keep the better solution in each region"""
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
    """the prior's surface is kept where the model explains no more than this share of the polarization at the prior's slopes; with a map of the surroundings, fixed limits apply instead"""
    explained_enough: float
    """the refined surface is kept where the model explains at least this share of the polarization at the prior's slopes; between explained_least and this, both are blended"""
    anchor: float
    """waves longer than a Gaussian of this number times the square root of (noise of the prior's points in GSD times their spacing in px), in px, are the prior's; larger: polarization also decides longer waves; 0 = no such limit"""


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
    """triangles with a larger angle between normal and viewing ray are left out, in degrees: they are sides of depth steps"""
    min_step_gsd: float
    """depth steps between neighboring pixels up to this many GSD are never cut by step_ratio"""
    step_ratio: float
    """the mesh is cut at a depth step larger than min_step_gsd if the step exceeds this many times the steps right before and after it"""
    max_sigma_gsd: float | Literal["auto"]
    """the mesh leaves out pixels whose standard deviation of depth exceeds this many GSD, such as ragged rims and guessed parts; auto = 10, or four times that of the coarse surface if this is more"""
    white_percentile: float
    """intensity percentile that becomes white in the vertex colors"""
    dem_pixel: float | Literal["auto"]
    """side of a pixel of the elevation model (dem.tif), in the station's unit; auto = as fine as the mesh"""
    glb_triangles: int
    """surface.glb takes every n-th pixel as a vertex, with n so large that it has at most about this many triangles"""
    glb_texture_px: int
    """longest side of the texture in surface.glb; larger images are reduced by averaging"""


class SurfaceValues(TypedDict, total=False):
    """The same as a mapping, any of them."""

    subsample: int
    max_incidence_deg: float
    min_step_gsd: float
    step_ratio: float
    max_sigma_gsd: float | Literal["auto"]
    white_percentile: float
    dem_pixel: float | Literal["auto"]
    glb_triangles: int
    glb_texture_px: int


class AssessSection(Section):
    """Options of the section assess."""

    polarization_height: bool
    """compute zenith and height from polarization alone, too, to show them beside the fused surface; grid fusion needs them"""
    detail_sigma_px: float
    """standard deviation of the Gaussian that separates detail (what the Gaussian removes) from low frequencies, in px"""
    histogram_bins: int
    """number of classes of the distance histograms; 0 = chosen by the spread and number of the distances"""
    histogram_range_gsd: float | Literal["auto"]
    """histograms span minus to plus this, in GSD; auto = the range of the distances without far outliers"""
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
