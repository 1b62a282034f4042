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
  report.iterations = {{.change_gsd = 3, .accepted_steps = 2, .tiles = 2},
                       {.change_gsd = 0.2, .accepted_steps = 2, .tiles = 2},
                       {.search = true, .change_gsd = 9, .accepted_steps = 2, .tiles = 2}};
  report.median_residual = 0.9;
  report.trusted_share = 0.97;
  report.explained_share = 0.85;
  report.explained_beyond_plane = 0.7;
  return report;
}

/// A round in which the solver tried steps without success.
void stick(RefineIteration& round) {
  round.accepted_steps = 0;
  round.rejected_steps = 8;
  round.change_gsd = 0;
}

/// The same in all rounds but those of the search.
RefineReport never_moved() {
  RefineReport report = good();
  stick(report.iterations[0]);
  stick(report.iterations[1]);
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
  RefineReport report = never_moved();
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

TEST(Verdict, ASurfaceThatMovedIsBetterThanThePriorWhateverTheLastRoundFound) {
  RefineReport report = good();
  report.iterations[1].rejected_steps = 100;
  EXPECT_EQ(judged(report).status, FusionStatus::converged) << "some steps were accepted";
  report.iterations.insert(report.iterations.begin() + 2, {.tiles = 2});
  stick(report.iterations[2]);
  FusedSurface surface = judged(report);
  EXPECT_EQ(surface.status, FusionStatus::converged) << "the rounds before had settled";
  EXPECT_TRUE(surface.warnings.empty());
  report.iterations[1].change_gsd = 1.5;
  surface = judged(report);
  EXPECT_EQ(surface.status, FusionStatus::not_converged);
  EXPECT_EQ(surface.confidence.level, ConfidenceLevel::partial);
  EXPECT_TRUE(
      mentions(surface.warnings, "still changing when the refinement ended, by 1.5 GSD in the last round that"));
  EXPECT_FALSE(mentions(surface.warnings, "than the prior"));
  report.iterations[1].binning = 2;
  EXPECT_TRUE(mentions(judged(report).warnings, "by 3 GSD")) << "the station's GSD";
  surface = judged(never_moved());
  EXPECT_EQ(surface.status, FusionStatus::not_converged);
  EXPECT_TRUE(mentions(surface.warnings, "no better surface than the prior")) << "the search changed another surface";
}

TEST(Verdict, TheLastRoundIsNoneOfTheSearch) {
  RefineReport report = good();
  EXPECT_EQ(&last_round(report), &report.iterations[1]);
  EXPECT_TRUE(has_settled(report)) << "the search moved by 9 GSD, but another surface";
  report.iterations[1].change_gsd = 2;
  report.iterations[2].change_gsd = 0.1;
  EXPECT_FALSE(has_settled(report));
  report.iterations.push_back({.change_gsd = 0.3, .accepted_steps = 2, .tiles = 2});
  EXPECT_EQ(&last_round(report), &report.iterations[3]);
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
  RefineReport report = never_moved();
  report.trusted_share = 0.01;
  report.metal = true;
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

TEST(Verdict, SaysThatTheShapeDoesNotTellTheReliefFromTheLight) {
  RefineReport report = good();
  report.trusted_share = 0.5;
  EXPECT_FALSE(mentions(judged(report).confidence.reasons, "each normal of the object"));
  report.shape_share = 0.5;
  EXPECT_TRUE(mentions(judged(report).confidence.reasons, "each normal of the object"));
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

TEST(Verdict, SaysThatTheObjectIsTakenForMetalWithoutEvidenceToo) {
  RefineReport report = good();
  report.metal_index = {2.5, 3};
  for (const double trusted : {0.97, nan}) {
    report.trusted_share = trusted;
    EXPECT_TRUE(mentions(judged(report).warnings, "taken for bare metal")) << trusted;
  }
  report.trusted_share = 0;
  EXPECT_FALSE(mentions(judged(report).warnings, "taken for bare metal")) << "no slope is of that light";
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
