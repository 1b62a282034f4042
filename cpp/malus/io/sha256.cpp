#include <openssl/evp.h>

#include <array>
#include <memory>
#include <stdexcept>

#include "malus/io/input_file_internal.h"
#include "malus/io/sha256_internal.h"

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

std::string sha256_of_file(const std::filesystem::path& path, const std::string& what) {
  InputFile file(path, what);
  Sha256 hash;
  for (std::string_view part = file.buffered(); !part.empty(); part = file.buffered()) {
    hash.add(part);
    file.skip(part.size());
  }
  return hash.hex();
}

}  // namespace malus
