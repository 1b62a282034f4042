#include "malus/io/sha256.h"

#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <future>
#include <memory>
#include <stdexcept>
#include <utility>

#include "malus/core/large_allocator.h"
#include "malus/io/input_file.h"

namespace malus {
namespace {

class Sha256 {
 public:
  Sha256() : context_(EVP_MD_CTX_new(), EVP_MD_CTX_free) {
    if (!context_ || EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) != 1) fail();
  }

  void add(std::string_view bytes) {
    if (EVP_DigestUpdate(context_.get(), bytes.data(), bytes.size()) != 1) fail();
  }

  std::string hex() {
    std::array<unsigned char, EVP_MAX_MD_SIZE> digest;
    unsigned length = 0;
    if (EVP_DigestFinal_ex(context_.get(), digest.data(), &length) != 1) fail();
    constexpr std::string_view digits = "0123456789abcdef";
    std::string text;
    for (unsigned i = 0; i < length; ++i) {
      text += digits[digest[i] >> 4];
      text += digits[digest[i] & 15];
    }
    return text;
  }

 private:
  // OpenSSL fails here only without memory or when SHA-256 is disabled on the machine.
  [[noreturn]] static void fail() { throw std::runtime_error("OpenSSL cannot compute SHA-256"); }

  std::unique_ptr<EVP_MD_CTX, void (*)(EVP_MD_CTX*)> context_;
};

}  // namespace

std::string sha256_of_bytes(std::string_view bytes) {
  Sha256 hash;
  hash.add(bytes);
  return hash.hex();
}

std::string sha256_of_file(const std::filesystem::path& path, const std::string& what, AfterHash after) {
  constexpr std::size_t largest_part = 4 << 20, page = 4096;
  InputFile file(path, what);
  if (after == AfterHash::not_read_soon && file.size() > 4 * largest_part) file.pass_by_cache();
  const auto part = static_cast<std::size_t>(std::min<std::uint64_t>(largest_part, (file.size() / page + 1) * page));
  Sha256 hash;
  LargeVector<char> memory(2 * part + page);
  void* pages = memory.data();
  std::size_t space = memory.size();
  std::align(page, 2 * part, pages, space);
  std::array<char*, 2> parts{static_cast<char*>(pages), static_cast<char*>(pages) + part};
  const auto read = [&file, part](char* to) { return file.read_some(to, part); };
  std::size_t length = read(parts[0]);
  while (length > 0) {
    // The next part is read while this one is hashed.
    std::future<std::size_t> next;
    if (file.remaining() > 0) next = std::async(std::launch::async, read, parts[1]);
    hash.add({parts[0], length});
    length = next.valid() ? next.get() : 0;
    std::swap(parts[0], parts[1]);
  }
  return hash.hex();
}

}  // namespace malus
