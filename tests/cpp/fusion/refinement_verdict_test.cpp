#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "malus/fusion/refinement_verdict_internal.h"

namespace malus {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double explained_least = 0.35;

/// Report of a surface without any reason for doubt.
RefineReport good() {
  RefineReport report;
  report.tiles = 20;
  report.iterations = {
      {.change_gsd = 3, .tiles = 2}, {.change_gsd = 0.2, .tiles = 2}, {.search = true, .change_gsd = 9, .tiles = 2}};
  report.median_residual = 0.9;
  report.trusted_share = 0.97;
  report.explained_share = 0.85;
  report.explained_beyond_plane = 0.7;
  return report;
}

FusedSurface judged(const RefineReport& report) {
  FusedSurface surface;
  judge(report, explained_least, surface);
  return surface;
}

bool mentions(const std::vector<std::string>& texts, const std::string& word) {
  return std::ranges::any_of(texts, [&](const std::string& text) { return text.find(word) != std::string::npos; });
}

TEST(Verdict, AGoodSurfaceHasHighConfidence) {
  const FusedSurface surface = judged(good());
  EXPECT_EQ(surface.status, FusionStatus::converged);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::high);
  EXPECT_TRUE(surface.confidence.reasons.empty());
  EXPECT_TRUE(surface.warnings.empty());
}

TEST(Verdict, EveryReasonIsKeptAndTheWorstComesFirst) {
  RefineReport report = good();
  report.iterations[1].rejected_steps = 100;
  report.metal = true;
  report.median_residual = 4.123456789;
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.status, FusionStatus::not_converged) << "the status describes the solver, not the model";
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::low);
  ASSERT_EQ(surface.confidence.reasons.size(), 3u);
  EXPECT_TRUE(mentions({surface.confidence.reasons[0]}, "metal"));
  EXPECT_TRUE(mentions(surface.confidence.reasons, "no better surface"));
  EXPECT_TRUE(mentions(surface.confidence.reasons, "residual is 4.1 standard"));
  EXPECT_EQ(surface.warnings.size(), 3u);
}

TEST(Verdict, TilesWithoutTheObjectRejectNothing) {
  RefineReport report = good();
  report.iterations[1].rejected_steps = 7;
  EXPECT_EQ(judged(report).status, FusionStatus::converged);
  report.iterations[1].rejected_steps = 8;  // no step was accepted in either of the two tiles with the object
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.status, FusionStatus::not_converged);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
}

TEST(Verdict, PartsThatCouldNotBeSolvedAreNotConverged) {
  RefineReport report = good();
  report.iterations[1].failed_tiles = 1;
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.status, FusionStatus::not_converged);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  EXPECT_TRUE(mentions(surface.warnings, "in 1 of 2 parts"));
  report = good();
  report.iterations[2].failed_tiles = 1;
  EXPECT_EQ(judged(report).status, FusionStatus::converged) << "the search for a second solution found none there";
}

TEST(Verdict, AnUnconvergedSurfaceThatKeptThePriorIsPartial) {
  RefineReport report = good();
  report.iterations[1].change_gsd = 1.23456789;
  report.trusted_share = 0;
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.status, FusionStatus::not_converged);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  ASSERT_EQ(surface.confidence.reasons.size(), 1u);
  EXPECT_TRUE(mentions(surface.confidence.reasons, "did not come to rest"));
  EXPECT_TRUE(mentions(surface.warnings, "still changing when the refinement ended, by 1.2 GSD"));
}

TEST(Verdict, AWrongModelIsHarmlessIfThePriorWasKept) {
  RefineReport report = good();
  report.trusted_share = 0.01;
  report.metal = true;
  report.iterations[1].rejected_steps = 100;
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  EXPECT_TRUE(mentions({surface.confidence.reasons[0]}, "The surface is the prior's"));
  EXPECT_TRUE(mentions(surface.confidence.reasons, "metal"));
  EXPECT_FALSE(mentions(surface.confidence.reasons, "no better")) << "that surface is not the result";
  EXPECT_TRUE(mentions(surface.warnings, "no better"));
}

TEST(Verdict, AModelThatWasNotAskedIsNotBlamed) {
  RefineReport report = good();
  report.trusted_share = report.explained_share = report.explained_beyond_plane = 0;
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  EXPECT_TRUE(mentions(surface.confidence.reasons, "enough pixels"));
  EXPECT_FALSE(mentions(surface.confidence.reasons, "does not explain"));
}

TEST(Verdict, PolarizationThatAPlaneExplainsIsNoEvidenceOfRelief) {
  RefineReport report = good();
  report.explained_beyond_plane = 0.1;
  EXPECT_EQ(judged(report).confidence.level, ConfidenceLevel::partial);
  EXPECT_TRUE(mentions(judged(report).confidence.reasons, "plane"));
}

TEST(Verdict, MissingFiguresLowerTheConfidence) {
  for (double RefineReport::*const figure :
       {&RefineReport::trusted_share, &RefineReport::explained_share, &RefineReport::explained_beyond_plane}) {
    RefineReport report = good();
    report.*figure = nan;
    EXPECT_EQ(judged(report).confidence.level, ConfidenceLevel::partial);
  }
  RefineReport report = good();
  report.median_residual = nan;
  EXPECT_EQ(judged(report).confidence.level, ConfidenceLevel::low);
  report = good();
  report.iterations[1].change_gsd = nan;
  EXPECT_EQ(judged(report).status, FusionStatus::not_converged);
}

TEST(Verdict, AnIndexThatDiffersFromTheStatedOneLowersTheConfidence) {
  RefineReport report = good();
  report.stated_eta = 1.5;
  report.eta_sigma = 0.06;
  report.reflection.eta = 1.8;
  const FusedSurface surface = judged(report);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  EXPECT_TRUE(mentions(surface.confidence.reasons, "contradicts optics.refractive_index = 1.5"));
  EXPECT_TRUE(mentions(surface.warnings, "contradicts optics.refractive_index = 1.5"));
}

TEST(Verdict, AStatedMetalThatTheImagesContradictLowersTheConfidence) {
  RefineReport report = good();
  report.metal_index = {0.519, 2.415};
  report.stated_metal = {.intensity_error = 0.1, .stokes_cost = 2.9, .dielectric_stokes_cost = 2.8};
  EXPECT_EQ(judged(report).confidence.level, ConfidenceLevel::high);
  EXPECT_TRUE(mentions(judged(report).warnings, "0.52 + 2.4 i, as optics.metal states"));
  EXPECT_FALSE(mentions(judged(report).warnings, "contradict"));
  report.stated_metal->intensity_error = 0.63;
  EXPECT_EQ(judged(report).confidence.level, ConfidenceLevel::low);
  EXPECT_TRUE(mentions(judged(report).warnings, "contradict optics.metal"));
  EXPECT_TRUE(mentions(judged(report).confidence.reasons, "off by 63 %"));
  EXPECT_FALSE(mentions(judged(report).warnings, "clearly better"));
  report.stated_metal = {.intensity_error = 0.1, .stokes_cost = 2.9, .dielectric_stokes_cost = 1.2};
  EXPECT_TRUE(mentions(judged(report).warnings, "explains the polarization clearly better"));
  EXPECT_FALSE(mentions(judged(report).warnings, "off by"));
  report.trusted_share = 0;
  EXPECT_EQ(judged(report).confidence.level, ConfidenceLevel::partial) << "the prior's surface is not in doubt";
  EXPECT_TRUE(mentions(judged(report).warnings, "a metal whose color changes"));
}

TEST(Verdict, WarnsOfAnIndexThatIsNeitherGivenNorEstimated) {
  RefineReport report = good();
  report.eta_sigma = nan;
  report.reflection.eta = 1.5;
  EXPECT_TRUE(mentions(judged(report).warnings, "refractive index is not known"));
  EXPECT_TRUE(mentions(judged(report).warnings, "1.5 is used"));
}

}  // namespace
}  // namespace malus
