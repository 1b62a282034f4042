#pragma once

// MALUS_FIELDS(a, b, …) in a struct lists these members once for all code that writes or reads them by name. It defines
// fields(self, visit), which calls visit("a", self.a), visit("b", self.b), … Structs whose fields carry more than a
// name, such as the range of an option, define fields() themselves (core/fields.h).

#define MALUS_FIELDS(...)                           \
  template <class Self, class Visitor>              \
  static void fields(Self& self, Visitor&& visit) { \
    MALUS_RESCAN_64(MALUS_VISIT(__VA_ARGS__))       \
  }

// Each time the preprocessor scans the text again, it expands one more field. MALUS_RESCAN_64 forces at least 64 scans.
#define MALUS_VISIT(field, ...) \
  visit(#field, self.field);    \
  __VA_OPT__(MALUS_VISIT_NEXT MALUS_NO_ARGUMENTS(__VA_ARGS__))
#define MALUS_VISIT_NEXT() MALUS_VISIT
#define MALUS_NO_ARGUMENTS ()
#define MALUS_RESCAN_64(...) MALUS_RESCAN_16(MALUS_RESCAN_16(MALUS_RESCAN_16(MALUS_RESCAN_16(__VA_ARGS__))))
#define MALUS_RESCAN_16(...) MALUS_RESCAN_4(MALUS_RESCAN_4(MALUS_RESCAN_4(MALUS_RESCAN_4(__VA_ARGS__))))
#define MALUS_RESCAN_4(...) MALUS_RESCAN(MALUS_RESCAN(MALUS_RESCAN(MALUS_RESCAN(__VA_ARGS__))))
#define MALUS_RESCAN(...) __VA_ARGS__
