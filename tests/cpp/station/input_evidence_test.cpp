#include <gtest/gtest.h>

#include "malus/station/results.h"

namespace malus {
namespace {

Finding finding(Severity severity, const std::string& message) {
  return {"order", severity, message, "look", {}};
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

}  // namespace
}  // namespace malus
