#include <Eigen/CholmodSupport>
#include <cmath>
#include <sstream>
#include <string>

#include "malus/linalg/sequential_blas_internal.h"
#include "malus/linalg/symmetric_solver_internal.h"

namespace malus {
namespace {

void require_square_compressed(const SymmetricSolver::Matrix& lower) {
  if (lower.rows() != lower.cols() || !lower.isCompressed()) {
    throw input_error("linear system: expected a square, compressed matrix");
  }
}

}  // namespace

struct SymmetricSolver::Impl {
  explicit Impl(const Context& context_in) : context(context_in) {
    cholmod_start(&common);
    common.print = 0;
    // L·Lᵀ and not L·D·Lᵀ, which would accept an indefinite matrix.
    common.supernodal = CHOLMOD_SUPERNODAL;
    // Nested dissection: on pixel grids it fills in far less than minimum degree.
    common.nmethods = 1;
    common.method[0].ordering = CHOLMOD_METIS;
    common.postorder = 1;
  }
  ~Impl() {
    free_factor();
    cholmod_finish(&common);
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  bool factorized() const { return factor != nullptr && factor->xtype == CHOLMOD_REAL; }
  void free_factor() {
    if (factor != nullptr) cholmod_free_factor(&factor, &common);
  }

  /// Throws if CHOLMOD failed; `what` names the operation.
  void check(const char* what) {
    if (common.status >= CHOLMOD_OK) return;
    const int status = common.status;
    common.status = CHOLMOD_OK;
    if (status == CHOLMOD_OUT_OF_MEMORY || status == CHOLMOD_TOO_LARGE) throw out_of_memory(what);
    std::ostringstream message;
    message << "linear system of " << unknowns << " unknowns: CHOLMOD failed with status " << status << " while "
            << what;
    throw Error(ErrorCode::external, message.str());
  }
  Error out_of_memory(const char* what) const {
    std::ostringstream message;
    message << "linear system of " << unknowns << " unknowns: out of memory while " << what << " (the factor takes "
            << factor_bytes / 1e9 << " GB)";
    return resource_error(message.str());
  }

  /// Replaces right-hand sides by their solutions.
  void apply_inverse(Eigen::Ref<Eigen::MatrixXd> columns) {
    const SequentialBlas sequential;
    cholmod_dense right = Eigen::viewAsCholmod(columns);
    cholmod_dense* solution = cholmod_solve(CHOLMOD_A, factor, &right, &common);
    check("solving");
    columns =
        Eigen::Map<const Eigen::MatrixXd>(static_cast<const double*>(solution->x), columns.rows(), columns.cols());
    cholmod_free_dense(&solution, &common);
  }

  const Context context;
  cholmod_common common{};
  cholmod_factor* factor = nullptr;
  Eigen::Index unknowns = 0;
  Eigen::Index entries = 0;
  double factor_bytes = 0;
};

SymmetricSolver::SymmetricSolver(const Context& context) : impl_(std::make_unique<Impl>(context)) {}
SymmetricSolver::~SymmetricSolver() = default;
SymmetricSolver::SymmetricSolver(SymmetricSolver&&) noexcept = default;
SymmetricSolver& SymmetricSolver::operator=(SymmetricSolver&&) noexcept = default;

void SymmetricSolver::analyze(const Matrix& lower, std::span<const int> order) {
  require_square_compressed(lower);
  if (!order.empty() && order.size() != static_cast<std::size_t>(lower.rows())) {
    throw input_error("linear system: the elimination order has another size than the matrix");
  }
  impl_->context.check_cancel();
  impl_->free_factor();
  impl_->unknowns = lower.rows();
  impl_->entries = lower.nonZeros();
  cholmod_sparse matrix = Eigen::viewAsCholmod(lower.selfadjointView<Eigen::Lower>());
  impl_->common.method[0].ordering = order.empty() ? CHOLMOD_METIS : CHOLMOD_GIVEN;
  impl_->factor = cholmod_analyze_p(&matrix, const_cast<int*>(order.data()), nullptr, 0, &impl_->common);
  impl_->check("ordering");
  impl_->factor_bytes = 8 * impl_->common.lnz;
  impl_->context.check_cancel();
}

SolveStatus SymmetricSolver::factorize(const Matrix& lower) {
  if (impl_->factor == nullptr) analyze(lower);
  require_square_compressed(lower);
  if (lower.rows() != impl_->unknowns || lower.nonZeros() != impl_->entries) {
    throw input_error("linear system: the matrix has another pattern than the analyzed one");
  }
  impl_->context.check_cancel();
  const SequentialBlas sequential;
  cholmod_sparse matrix = Eigen::viewAsCholmod(lower.selfadjointView<Eigen::Lower>());
  cholmod_factorize(&matrix, impl_->factor, &impl_->common);
  impl_->check("factorizing");
  impl_->context.check_cancel();
  // CHOLMOD reports a failure at a column as a warning, not as an error.
  return impl_->factor->minor == impl_->factor->n ? SolveStatus::solved : SolveStatus::not_positive_definite;
}

SolveStatus SymmetricSolver::solve(const Matrix& lower, const Eigen::VectorXd& b, Eigen::VectorXd& x,
                                   double residual_limit) {
  if (!impl_->factorized() || b.size() != impl_->unknowns || lower.rows() != impl_->unknowns) {
    throw input_error("linear system: factorize a matrix of the right-hand side's size first");
  }
  const auto residual = [&] { return Eigen::VectorXd(b - lower.selfadjointView<Eigen::Lower>() * x); };
  x = b;
  impl_->apply_inverse(x);
  Eigen::VectorXd rest = residual();
  const double scale = b.norm() > 0 ? b.norm() : 1;
  if (rest.norm() > 1e-12 * scale) {
    impl_->apply_inverse(rest);
    x += rest;
    rest = residual();
  }
  return rest.norm() / scale <= residual_limit ? SolveStatus::solved : SolveStatus::inaccurate;
}

void SymmetricSolver::solve_columns(Eigen::MatrixXd& columns) const {
  if (!impl_->factorized() || columns.rows() != impl_->unknowns) {
    throw input_error("linear system: factorize a matrix of the right-hand sides' size first");
  }
  impl_->apply_inverse(columns);
}

double SymmetricSolver::log_determinant() const {
  if (!impl_->factorized()) {
    throw input_error("linear system: factorize a matrix before asking for its determinant");
  }
  const cholmod_factor& factor = *impl_->factor;
  const double* x = static_cast<const double*>(factor.x);
  double sum = 0;
  const int* super = static_cast<const int*>(factor.super);
  const int* rows = static_cast<const int*>(factor.pi);
  const int* values = static_cast<const int*>(factor.px);
  for (std::size_t s = 0; s < factor.nsuper; ++s) {
    const int stride = rows[s + 1] - rows[s] + 1;
    for (int column = 0; column < super[s + 1] - super[s]; ++column) sum += std::log(x[values[s] + column * stride]);
  }
  return 2 * sum;
}

double SymmetricSolver::factor_bytes() const {
  return impl_->factor_bytes;
}

}  // namespace malus
