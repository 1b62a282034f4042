#include <gtest/gtest.h>

#include "malus/core/metal_internal.h"
#include "thrown_error.h"

namespace malus {
namespace {

TEST(Metal, NamesAndIndicesAreRead) {
  EXPECT_EQ(read_metal_statement("bronze")->index, std::complex(0.519, 2.415));
  EXPECT_EQ(read_metal_statement("0.7+2.6i")->index, std::complex(0.7, 2.6));
  EXPECT_EQ(read_metal_statement(" 0.7 + 2.6 i")->index, std::complex(0.7, 2.6));
  EXPECT_EQ(read_metal_statement(metal_index_text(0.1, 12))->index, std::complex(0.1, 12.0));
  for (const char* name : {"silver", "gold", "copper", "bronze", "brass", "iron", "lead", "tin", "aluminum"}) {
    const std::optional<MetalStatement> metal = read_metal_statement(name);
    ASSERT_TRUE(metal) << name;
    EXPECT_TRUE(metal->names_metal()) << name;
    // Each index is one that the station file accepts as numbers, too.
    EXPECT_TRUE(read_metal_statement(metal_index_text(metal->index.real(), metal->index.imag()))) << name;
  }
}

TEST(Metal, AutoAndNoneNameNoMetal) {
  EXPECT_FALSE(read_metal_statement("auto")->names_metal());
  EXPECT_FALSE(read_metal_statement("auto")->excluded);
  EXPECT_FALSE(read_metal_statement("none")->names_metal());
  EXPECT_TRUE(read_metal_statement("none")->excluded);
}

TEST(Metal, OtherTextsAreRefused) {
  for (const char* text : {"", "bronz", "Bronze", "0.7", "0.7+2.6", "0.7-2.6i", "0.7+-2.6i", "2.6i", "1.5+0i",
                           "0.7+2.6i, or so", "nan+2.6i", "0.7+infi", "-0.7+2.6i"})
    EXPECT_FALSE(read_metal_statement(text)) << text;
  const auto refused = [](const char* text, ReflectionChoice reflection, const auto&... parts) {
    expect_error(
        ErrorCode::input, [&] { accepted_metal(text, reflection); }, parts...);
  };
  refused("bronz", ReflectionChoice::automatic, "optics.metal = \"bronz\"", "\"bronze\"", "k from 0.5 to 20");
  refused("gold", ReflectionChoice::diffuse, "optics.metal = \"gold\"", "reflection = \"diffuse\"");
  refused("gold", ReflectionChoice::labels, "labels of the reflection");
  EXPECT_EQ(accepted_metal("none", ReflectionChoice::diffuse).text, "none");
  EXPECT_TRUE(accepted_metal("gold", ReflectionChoice::specular).names_metal());
}

}  // namespace
}  // namespace malus
