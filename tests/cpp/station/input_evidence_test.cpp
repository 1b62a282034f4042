#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "malus/station/results.h"
#include "malus/station/step_functions_internal.h"

namespace malus {
namespace {

Finding finding(Severity severity, const std::string& message) {
  return {Check::order, severity, message, "look", {}};
}

TEST(InputEvidence, NotesDoNotLimitTheConfidence) {
  Confidence confidence;
  InputEvidence{{finding(Severity::note, "all is well")}}.limit(confidence);
  EXPECT_EQ(confidence.level, ConfidenceLevel::high);
  EXPECT_TRUE(confidence.reasons.empty());
}

TEST(InputEvidence, CautionsLimitTheConfidenceToPartialAndWarningsToLow) {
  Confidence confidence;
  InputEvidence{{finding(Severity::caution, "some pixels are off")}}.limit(confidence);
  EXPECT_EQ(confidence.level, ConfidenceLevel::partial);
  InputEvidence{{finding(Severity::warning, "in another order"), finding(Severity::note, "fine")}}.limit(confidence);
  EXPECT_EQ(confidence.level, ConfidenceLevel::low);
  EXPECT_EQ(confidence.reasons, (std::vector<std::string>{"in another order; look", "some pixels are off; look"}))
      << "the worst finding comes first";
}

/// The evidence of a station without a prior, and what the step logs.
struct EvidenceOfImages {
  std::string said;
  InputEvidence evidence;

  explicit EvidenceOfImages(const PolarizerCalibration& calibration) {
    Context context;
    context.on_log = [this](LogLevel, const std::string& message) { said += message; };
    const Station station{};
    const Options options{};
    const RunOptions run{};
    StepFiles files;
    Json times;
    const ImageFindings of_images{{finding(Severity::warning, "in another order")}};
    evidence = check_inputs({station, options, run, context, files, times}, of_images, {nullptr, calibration}, {}, {},
                            nullptr);
  }
};

TEST(InputEvidence, AWrongScaleOfThePolarizerLimitsTheConfidence) {
  PolarizerCalibration calibration;
  EXPECT_EQ(EvidenceOfImages(calibration).evidence.findings.size(), 1u);
  calibration.doubt = "is angle_zero_deg off by 90°?";
  const std::vector<Finding> asked = EvidenceOfImages(calibration).evidence.findings;
  ASSERT_EQ(asked.size(), 2u);
  EXPECT_EQ(asked[1].check, Check::scale);
  EXPECT_EQ(asked[1].severity, Severity::caution);
  EXPECT_EQ(asked[1].message, calibration.doubt);
  calibration.is_contradicted = true;
  EXPECT_EQ(EvidenceOfImages(calibration).evidence.findings[1].severity, Severity::warning);
}

TEST(InputEvidence, DoesNotRepeatWhatTheStepsBeforeSaid) {
  PolarizerCalibration calibration;
  calibration.doubt = "is angle_zero_deg off by 90°?";
  EXPECT_EQ(EvidenceOfImages(calibration).said, "");
}

}  // namespace
}  // namespace malus
