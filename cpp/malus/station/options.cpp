#include "malus/station/options.h"

#include <cmath>

#include "malus/io/nearest_name_internal.h"
#include "malus/io/toml_json_internal.h"
#include "malus/station/json_fields_internal.h"

namespace malus {
namespace {

template <class T>
Json option_to_json(const T& value) {
  if constexpr (IsOptional<T>::value) {
    return value ? Json(*value) : Json("auto");
  } else {
    return fields_to_json(value);
  }
}

/// Values that an option of this type accepts, as text for messages and help.
template <class T>
std::string option_type(T example = {}) {
  if constexpr (IsOptional<T>::value) {
    return option_type<typename T::value_type>() + " or \"auto\"";
  } else if constexpr (NamedEnum<T>) {
    std::string text;
    for (const std::string_view name : names_of(example))
      text += (text.empty() ? "\"" : " | \"") + std::string(name) + '"';
    return text;
  } else if constexpr (std::same_as<T, bool>) {
    return "true or false";
  } else if constexpr (std::same_as<T, int>) {
    return "a whole number";
  } else {
    return "a number";
  }
}

/// Sets one option from JSON; throws an input error that names it (`name` = "section.key") on a wrong type.
template <class T>
void option_from_json(T& target, const Json& json, const std::string& name) {
  const auto fail = [&] {
    return input_error("option " + name + " = " + json.dump() + ", expected " + option_type<T>());
  };
  if constexpr (IsOptional<T>::value) {
    if (json.is_null() || json == "auto") {
      target.reset();
    } else {
      typename T::value_type inner{};
      option_from_json(inner, json, name);
      target = inner;
    }
  } else if constexpr (NamedEnum<T>) {
    if (!json.is_string()) throw fail();
    const auto value = enum_value<T>(json.get<std::string>());
    if (!value) throw fail();
    target = *value;
  } else if constexpr (std::same_as<T, bool>) {
    if (!json.is_boolean()) throw fail();
    target = json.get<bool>();
  } else if constexpr (std::same_as<T, int>) {
    if (!json.is_number_integer() || std::abs(json.get<double>()) > 2e9) throw fail();
    target = json.get<int>();
  } else {
    static_assert(std::same_as<T, double>, "option fields are bool, int, double, an enumeration or optional");
    if (!json.is_number()) throw fail();
    target = json.get<double>();
  }
}

template <class Section>
Json section_to_json(const Section& section) {
  Json json = Json::object();
  Section::fields(section, [&](std::string_view key, const auto& value, Range, std::string_view) {
    json[std::string(key)] = option_to_json(value);
  });
  return json;
}

template <class Section>
void section_from_json(Section& section, const Json& json, const std::string& name) {
  if (!json.is_object()) throw input_error("option section " + name + " = " + json.dump() + ", expected a table");
  for (const auto& item : json.items()) {
    const std::string& key = item.key();
    std::vector<std::string_view> known;
    bool found = false;
    Section::fields(section, [&](std::string_view field, auto& target, Range, std::string_view) {
      known.emplace_back(field);
      if (field == key) {
        option_from_json(target, item.value(), name + "." + key);
        found = true;
      }
    });
    if (!found) throw input_error("unknown option " + name + "." + key + hint_at_known_names(key, known, name + "."));
  }
}

Json parse_json(std::string_view text) {
  Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) throw input_error("options are not a JSON object");
  return json;
}

/// A command-line value: true, false or a number as such, anything else as text.
Json parse_value(const std::string& text) {
  const Json json = Json::parse(text, nullptr, false);
  return json.is_discarded() || json.is_structured() ? Json(text) : json;
}

}  // namespace

void Options::validate() const {
  sections(*this, [](std::string_view name, const auto& section) { validate_fields(section, name); });
}

std::string options_to_json(const Options& options) {
  Json json = {{"fusion", option_to_json(options.fusion)}};
  Options::sections(
      options, [&](std::string_view name, const auto& section) { json[std::string(name)] = section_to_json(section); });
  return json.dump();
}

Options options_from_json(const Options& options, std::string_view text) {
  Options result = options;
  const Json json = parse_json(text);
  for (const auto& [name, value] : json.items()) {
    if (name == "fusion") {
      option_from_json(result.fusion, value, name);
      continue;
    }
    std::vector<std::string_view> known{"fusion"};
    bool found = false;
    Options::sections(result, [&](std::string_view section_name, auto& section) {
      known.emplace_back(section_name);
      if (section_name == name) {
        section_from_json(section, value, name);
        found = true;
      }
    });
    if (!found) throw input_error("unknown option section " + name + hint_at_known_names(name, known));
  }
  result.validate();
  return result;
}

void set_option(Options& options, std::string_view assignment) {
  const std::size_t equals = assignment.find('=');
  const std::string name(assignment.substr(0, equals));
  const std::size_t dot = name.find('.');
  if (equals == std::string_view::npos || (dot == std::string::npos && name != "fusion")) {
    throw input_error("--set " + std::string(assignment) + ", expected section.key=value");
  }
  const Json value = parse_value(std::string(assignment.substr(equals + 1)));
  const Json change =
      dot == std::string::npos ? Json{{name, value}} : Json{{name.substr(0, dot), {{name.substr(dot + 1), value}}}};
  options = options_from_json(options, change.dump());
}

Options options_from_file(const Options& options, const std::filesystem::path& path) {
  try {
    return options_from_json(options, read_toml_as_json(path, "options file"));
  } catch (const Error& error) {
    const std::string where = path.string();
    const std::string message = error.what();
    throw Error(error.code(), message.starts_with(where) ? message : where + ": " + message);
  }
}

std::string option_schema_json() {
  const Options defaults;
  Json schema = Json::object();
  Options::sections(defaults, [&](std::string_view name, const auto& section) {
    Json& fields = schema[std::string(name)] = Json::object();
    using Section = std::remove_cvref_t<decltype(section)>;
    Section::fields(section, [&](std::string_view key, const auto& value, Range range, std::string_view doc) {
      Json field = {{"type", option_type<std::remove_cvref_t<decltype(value)>>()}, {"default", option_to_json(value)}};
      if (std::isfinite(range.min)) field["min"] = range.min;
      if (std::isfinite(range.max)) field["max"] = range.max;
      field["doc"] = doc;
      fields[std::string(key)] = field;
    });
  });
  return schema.dump();
}

}  // namespace malus
