#include <algorithm>
#include <utility>

#include "malus/core/simd.h"
#include "malus/linalg/node_stencil_internal.h"

namespace malus {
namespace {

template <class T>
struct Product {
  const T* a;
  const T* x;
};

/// Sum of products a[i] · x[i] over a segment. The sums stay in registers; the compiler makes a version for each
/// instruction set and the loader picks one.
template <class T>
[[gnu::always_inline]] inline void sum_products_body(const Product<T>* products, int count, T* sum) {
  constexpr int lanes = 64 / sizeof(T);
  using Vector [[gnu::vector_size(64), gnu::aligned(sizeof(T)), gnu::may_alias]] = T;
  for (int begin = 0; begin < segment_nodes; begin += 4 * lanes) {
    Vector sum0 = {}, sum1 = {}, sum2 = {}, sum3 = {};
    for (int k = 0; k < count; ++k) {
      const Vector* a = reinterpret_cast<const Vector*>(products[k].a + begin);
      const Vector* x = reinterpret_cast<const Vector*>(products[k].x + begin);
      sum0 += a[0] * x[0];
      sum1 += a[1] * x[1];
      sum2 += a[2] * x[2];
      sum3 += a[3] * x[3];
    }
    Vector* to = reinterpret_cast<Vector*>(sum + begin);
    to[0] = sum0, to[1] = sum1, to[2] = sum2, to[3] = sum3;
  }
}
MALUS_SIMD_CLONES void sum_products(const Product<float>* products, int count, float* sum) {
  sum_products_body(products, count, sum);
}
MALUS_SIMD_CLONES void sum_products(const Product<double>* products, int count, double* sum) {
  sum_products_body(products, count, sum);
}

}  // namespace

template <class T>
template <class U>
NodeStencil<T>::NodeStencil(const NodeStencil<U>& other, const Context& context)
    : nodes_(other.nodes_), segments_(other.segments_), table_(other.table_.size()), values_(other.values_.size()) {
  for (std::size_t i = 0; i < table_.size(); ++i) table_[i] = {other.table_[i].present, other.table_[i].start};
  constexpr std::size_t grain = std::size_t{1} << 18;
  parallel_for(context, values_.size(), grain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) values_[i] = static_cast<T>(other.values_[i]);
  });
}

template <class T>
void NodeStencil<T>::append(int row, int segment, const SegmentEntries& entries) {
  std::vector<T>& to = rows_[static_cast<std::size_t>(row)];
  Segment& s = table_[index(row, segment)];
  s.start = to.size();
  for (int k = 0; k < coupling_count; ++k) {
    const auto& values = entries[k];
    if (std::all_of(values.begin(), values.end(), [](double value) { return value == 0; })) continue;
    s.present[static_cast<std::size_t>(k) / 64] |= std::uint64_t{1} << (static_cast<std::size_t>(k) % 64);
    to.insert(to.end(), values.begin(), values.end());
  }
  // The other segments are often like the first: their values then need not be moved.
  if (segment == 0) to.reserve(to.size() * static_cast<std::size_t>(segments_));
}

template <class T>
void NodeStencil<T>::finish(const Context& context) {
  std::vector<std::size_t> starts(rows_.size());
  std::size_t count = 0;
  for (std::size_t row = 0; row < rows_.size(); ++row) starts[row] = std::exchange(count, count + rows_[row].size());
  values_.resize(count);
  parallel_rows(context, nodes_.height, [&](int row) {
    const std::size_t start = starts[static_cast<std::size_t>(row)];
    std::vector<T> from = std::move(rows_[static_cast<std::size_t>(row)]);
    std::copy(from.begin(), from.end(), values_.begin() + static_cast<std::ptrdiff_t>(start));
    for (int segment = 0; segment < segments_; ++segment) table_[index(row, segment)].start += start;
  });
  rows_ = {};
}

template <class T>
void NodeStencil<T>::multiply(const NodeVector<T>& x, int row, int segment, Values& product) const {
  std::array<std::array<Product<T>, 2 * coupling_count>, components> products;
  std::array<int, components> counts{};
  const auto add = [&](int component, const T* a, const T* with) {
    const std::size_t c = static_cast<std::size_t>(component);
    products[c][static_cast<std::size_t>(counts[c]++)] = {a, with};
  };
  const int node = first(segment);
  // Entries of this row, and their mirrors, in which this node is the later one; then mirrors from the row above.
  for (int up = 0; up <= std::min(row, 1); ++up) {
    const Segment& source = at(row - up, segment);
    const T* values = values_.data() + source.start + 1;
    for (std::size_t word = 0; word < 2; ++word) {
      for (std::uint64_t bits = source.present[word]; bits != 0; bits &= bits - 1, values += SegmentEntries::width) {
        const Coupling& k = couplings[64 * word + static_cast<std::size_t>(std::countr_zero(bits))];
        if (up == 0) add(k.from, values, x.at(k.to, node + k.column, row + k.row));
        const bool diagonal = k.column == 0 && k.row == 0 && k.from == k.to;
        if (k.row == up && !diagonal) add(k.to, values - k.column, x.at(k.from, node - k.column, row - up));
      }
    }
  }
  for (std::size_t c = 0; c < components; ++c) sum_products(products[c].data(), counts[c], product[c].data());
}

template class NodeStencil<double>;
template class NodeStencil<float>;
template NodeStencil<float>::NodeStencil(const NodeStencil<double>&, const Context&);

NodeStencil<double> node_stencil(const GridSystem& system, double ridge, const Context& context) {
  const PixelIndex& pixels = system.pixels();
  NodeStencil<double> stencil(node_size(pixels.size()));
  for_each_segment(context, stencil.nodes(), [&](int row, int segment) {
    SegmentEntries entries(stencil.first(segment), row);
    // One node more than the entries': its lower left neighbour may keep their common one.
    const int begin = std::max(0, 2 * stencil.first(segment) - 2), end = begin + 2 * SegmentEntries::width + 2;
    for (int v = 2 * row; v < 2 * row + 2; ++v) {
      for (int u = begin; u < end; ++u) {
        const int unknown = pixels.at(u, v);
        if (unknown < 0) continue;
        system.for_each_entry(unknown, [&](int du, int dv, double value) {
          if (du == 0 && dv == 0) value += ridge;
          const int u2 = u + du, v2 = v + dv;
          entries.add(u % 2 + 2 * (v % 2), u / 2, row, u2 % 2 + 2 * (v2 % 2), u2 / 2, v2 / 2, value);
        });
      }
    }
    stencil.append(row, segment, entries);
  });
  stencil.finish(context);
  return stencil;
}

namespace {

/// Values of one coupling along a part of a row.
constexpr int coarse_width = SegmentEntries::width + 2;
using FineLine = std::array<double, 2 * coarse_width + 1>;
using CoarseLine = std::array<double, coarse_width>;

/// Reads a coupling's values from node `begin` of a row on; false if all are zero.
bool read_line(const NodeStencil<double>& stencil, int row, int coupling, int begin, FineLine& line) {
  if (row < 0 || row >= stencil.nodes().height) return false;
  bool any = false;
  const int end = begin + static_cast<int>(line.size());
  for (int part = std::max(begin, 0) / segment_nodes; part < stencil.segments() && stencil.first(part) < end; ++part) {
    const double* values = stencil.find(row, part, coupling);
    if (values == nullptr) continue;
    if (!any) line.fill(0);
    any = true;
    const int from = std::max(begin, stencil.first(part)),
              to = std::min(end, stencil.first(part) + stencil.count(part));
    std::copy(values + 1 + from - stencil.first(part), values + 1 + to - stencil.first(part),
              line.begin() + (from - begin));
  }
  return any;
}

/// Adds a line of directed coarse entries to the symmetric ones: of component `from` of the nodes of a row with
/// component `to` of the nodes (column, rows) from them.
void add_line(const CoarseLine& line, int from, int to, int column, int rows, SegmentEntries& entries) {
  const bool mirrored = rows < 0 || (rows == 0 && (column < 0 || (column == 0 && to < from)));
  // The entry belongs to the earlier node, which for a mirrored one is `column` further on.
  auto& sum =
      mirrored ? entries[coupling_index(to, from, -column, -rows)] : entries[coupling_index(from, to, column, rows)];
  const double* values = line.data() + 1 - (mirrored ? column : 0);
  for (std::size_t i = 0; i < SegmentEntries::width; ++i) sum[i] += values[i];
}

/// What a coupling of the fine grid becomes along a row of the coarse grid: `line` holds its values, summed over the
/// fine rows, from the node left of the first coarse one on; `rows` is how far down the coarse partner lies.
void add_coarsened(const FineLine& line, const Coupling& k, int rows, double factor, bool diagonal,
                   SegmentEntries& entries) {
  CoarseLine before, same, after;
  for (std::size_t i = 0; i < coarse_width; ++i) {
    const double left = factor * line[2 * i], middle = factor * line[2 * i + 1], right = factor * line[2 * i + 2];
    if (k.column == 0) {
      before[i] = 0.25 * left;
      same[i] = middle + 0.25 * (left + right);
      after[i] = 0.25 * right;
    } else if (k.column > 0) {
      same[i] = 0.5 * (middle + left);
      after[i] = 0.5 * (middle + right);
    } else {
      before[i] = 0.5 * (middle + left);
      same[i] = 0.5 * (middle + right);
    }
  }
  const bool one_unknown = k.from == k.to && rows == 0;
  if (one_unknown && !diagonal) {
    // Both orders of two fine unknowns meet in one coarse unknown.
    for (double& value : same) value *= 2;
  }
  add_line(same, k.from, k.to, 0, rows, entries);
  if (k.column >= 0) add_line(after, k.from, k.to, 1, rows, entries);
  // A diagonal entry meets two coarse unknowns in both orders: one is enough.
  if (k.column <= 0 && !(diagonal && rows == 0)) add_line(before, k.from, k.to, -1, rows, entries);
}

}  // namespace

NodeStencil<double> coarsened(const NodeStencil<double>& fine, const Context& context) {
  NodeStencil<double> coarse(coarser(fine.nodes()));
  for_each_segment(context, coarse.nodes(), [&](int row, int segment) {
    SegmentEntries entries(coarse.first(segment), row);
    // Along an axis, an entry a of fine nodes x and x + d belongs to coarse nodes X = x / 2 and X + D with the product
    // of both weights: 1 at an even node, ½ and ½ at an odd one.
    const int begin = 2 * (coarse.first(segment) - 2) - 1;
    FineLine above, here, below, sum;
    for (int k = 0; k < coupling_count; ++k) {
      const bool has_above = read_line(fine, 2 * row - 1, k, begin, above),
                 has_here = read_line(fine, 2 * row, k, begin, here),
                 has_below = read_line(fine, 2 * row + 1, k, begin, below);
      if (!has_above && !has_here && !has_below) continue;
      if (!has_above) above.fill(0);
      if (!has_here) here.fill(0);
      if (!has_below) below.fill(0);
      const Coupling& c = couplings[static_cast<std::size_t>(k)];
      const bool diagonal = c.from == c.to && c.column == 0 && c.row == 0;
      if (c.row == 0) {
        for (std::size_t i = 0; i < sum.size(); ++i) sum[i] = here[i] + 0.25 * (above[i] + below[i]);
        add_coarsened(sum, c, 0, 1, diagonal, entries);
        add_coarsened(below, c, 1, 0.25, diagonal, entries);
        if (!diagonal) add_coarsened(below, c, -1, 0.25, diagonal, entries);
      } else {
        for (std::size_t i = 0; i < sum.size(); ++i) sum[i] = here[i] + above[i];
        add_coarsened(sum, c, 0, 0.5, diagonal, entries);
        for (std::size_t i = 0; i < sum.size(); ++i) sum[i] = here[i] + below[i];
        add_coarsened(sum, c, 1, 0.5, diagonal, entries);
      }
    }
    coarse.append(row, segment, entries);
  });
  coarse.finish(context);
  return coarse;
}

}  // namespace malus
