#include "direct.h"

#include <algorithm>
#include <cmath>

namespace {

double dot6(const double *a, const double *b) {
  return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5]);
}

// Four sums, so that one addition need not wait for the one before.
double dot(const double *a, const double *b, int n) {
  double s0 = 0, s1 = 0, s2 = 0, s3 = 0;
  int i = 0;
  for (; i + 4 <= n; i += 4) {
    s0 += a[i] * b[i];
    s1 += a[i + 1] * b[i + 1];
    s2 += a[i + 2] * b[i + 2];
    s3 += a[i + 3] * b[i + 3];
  }
  for (; i < n; ++i) s0 += a[i] * b[i];
  return (s0 + s1) + (s2 + s3);
}

double moved(const DirectRow::Side &side, const double *velocity) {
  return side.tree_jacobian ? dot(side.tree_jacobian, velocity, side.size) : dot6(side.jacobian, velocity);
}

// Entry of jacobian x inverse mass x jacobian^T.
double coupling(const DirectRow &a, const DirectRow &b) {
  double sum = 0;
  for (const DirectRow::Side &of : a.sides) {
    if (of.body < 0) continue;
    for (const DirectRow::Side &by : b.sides) {
      if (of.body == by.body) sum += moved(of, by.tree_response ? by.tree_response : by.response);
    }
  }
  return sum;
}

}  // namespace

double DirectSolver::prepare(int rigid, const Vector<int> &tree_sizes) {
  const int body_count = rigid + static_cast<int>(tree_sizes.size()), n = static_cast<int>(rows.size());
  velocity_start.resize(body_count + 1);
  for (int b = 0; b <= body_count; ++b) {
    velocity_start[b] = b <= rigid ? 6 * static_cast<size_t>(b) : velocity_start[b - 1] + tree_sizes[b - rigid - 1];
  }
  // Bodies in the order of a breadth-first search (Cuthill-McKee) that starts at the far end of another one.
  neighbour_start.assign(body_count + 1, 0);
  const auto joins = [](const DirectRow &row) { return row.sides[0].body >= 0 && row.sides[1].body >= 0; };
  // Consecutive rows mostly join the same bodies; one edge is enough.
  const auto repeats = [&](int i) {
    return i > 0 && rows[i].sides[0].body == rows[i - 1].sides[0].body && rows[i].sides[1].body == rows[i - 1].sides[1].body;
  };
  for (int i = 0; i < n; ++i) {
    if (!joins(rows[i]) || repeats(i)) continue;
    for (const DirectRow::Side &side : rows[i].sides) ++neighbour_start[side.body + 1];
  }
  for (int b = 0; b < body_count; ++b) neighbour_start[b + 1] += neighbour_start[b];
  neighbours.resize(neighbour_start[body_count]);
  body_first.assign(neighbour_start.begin(), neighbour_start.end());
  for (int i = 0; i < n; ++i) {
    if (!joins(rows[i]) || repeats(i)) continue;
    const int a = rows[i].sides[0].body, b = rows[i].sides[1].body;
    neighbours[body_first[a]++] = b;
    neighbours[body_first[b]++] = a;
  }
  body_place.assign(body_count, -1);
  queue.clear();
  const auto search = [&](int from) {
    const size_t begin = queue.size();
    body_place[from] = static_cast<int>(begin);
    queue.push_back(from);
    for (size_t at = begin; at < queue.size(); ++at) {
      for (int k = neighbour_start[queue[at]]; k < neighbour_start[queue[at] + 1]; ++k) {
        const int next = neighbours[k];
        if (body_place[next] >= 0) continue;
        body_place[next] = static_cast<int>(queue.size());
        queue.push_back(next);
      }
    }
  };
  for (int b = 0; b < body_count; ++b) {
    if (body_place[b] >= 0) continue;
    const size_t begin = queue.size();
    search(b);
    const int far_end = queue.back();
    for (size_t at = begin; at < queue.size(); ++at) body_place[queue[at]] = -1;
    queue.resize(begin);
    search(far_end);
  }
  // A row stands with the later of its bodies: counting sort, which keeps the rows of a pair in their order.
  const auto key = [&](const DirectRow &row) {
    int latest = 0;
    for (const DirectRow::Side &side : row.sides) latest = std::max(latest, side.body >= 0 ? body_place[side.body] : 0);
    return latest;
  };
  body_first.assign(body_count + 1, 0);
  for (const DirectRow &row : rows) ++body_first[key(row) + 1];
  for (int b = 0; b < body_count; ++b) body_first[b + 1] += body_first[b];
  order.resize(n);
  place.resize(n);
  for (int i = 0; i < n; ++i) {
    place[i] = body_first[key(rows[i])]++;
    order[place[i]] = i;
  }
  // A row reaches back to the first that shares a body.
  body_first.assign(body_count, n);
  first.resize(n);
  start.resize(n);
  size_t size = 0;
  double cost = 0;
  for (int p = 0; p < n; ++p) {
    const DirectRow &row = rows[order[p]];
    int reach = p;
    for (const DirectRow::Side &side : row.sides) {
      if (side.body < 0) continue;
      body_first[side.body] = std::min(body_first[side.body], p);
      reach = std::min(reach, body_first[side.body]);
    }
    first[p] = reach;
    start[p] = size;
    const double width = p - reach + 1;
    size += static_cast<size_t>(p - reach + 1);
    cost += width * width / 2;
  }
  work = cost;
  return cost;
}

void DirectSolver::assemble() {
  const int n = static_cast<int>(rows.size());
  matrix.resize(n ? start[n - 1] + static_cast<size_t>(n - first[n - 1]) : 0);
  for (int p = 0; p < n; ++p) {
    const DirectRow &row = rows[order[p]];
    double *entries = &matrix[start[p]];
    for (int q = first[p]; q <= p; ++q) *entries++ = coupling(row, rows[order[q]]);
    entries[-1] += row.cfm;
  }
}

void DirectSolver::factor() {
  ++rounds_;
  const int n = static_cast<int>(rows.size());
  free_rows.clear();
  free_first.clear();
  free_start.clear();
  factors.resize(matrix.size());
  inverse_diagonal.clear();
  size_t used = 0;
  // Where the free rows with at least this place begin.
  body_first.resize(n + 1);
  for (int p = 0; p < n; ++p) {
    body_first[p] = static_cast<int>(free_rows.size());
    const int row = order[p];
    if (rows[row].state != DirectRow::Free) continue;
    const int m = static_cast<int>(free_rows.size()), reach = body_first[first[p]];
    free_rows.push_back(row);
    free_first.push_back(reach);
    free_start.push_back(used);
    double *entries = &factors[used];
    used += static_cast<size_t>(m - reach + 1);
    const double *from = &matrix[start[p]];
    for (int k = reach; k < m; ++k) {
      const int low = std::max(reach, free_first[k]);
      const double *other = &factors[free_start[k]];
      entries[k - reach] = (from[place[free_rows[k]] - first[p]] -
                            dot(entries + (low - reach), other + (low - free_first[k]), k - low)) *
                           inverse_diagonal[k];
    }
    const double diagonal = from[p - first[p]];
    const double rest = diagonal - dot(entries, entries, m - reach);
    // What depends on the rows before it has nothing to add.
    inverse_diagonal.push_back(rest > 1e-13 * diagonal ? 1 / std::sqrt(rest) : 0);
  }
}

void DirectSolver::solve_free() {
  const int m = static_cast<int>(free_rows.size());
  unknowns.resize(m);
  for (int i = 0; i < m; ++i) {
    const DirectRow &row = rows[free_rows[i]];
    const int reach = free_first[i];
    unknowns[i] = (row.target - along(row) - dot(&factors[free_start[i]], &unknowns[reach], i - reach)) *
                  inverse_diagonal[i];
  }
  for (int i = m - 1; i >= 0; --i) {
    const double value = unknowns[i] *= inverse_diagonal[i];
    const double *entries = &factors[free_start[i]];
    double *others = unknowns.data() + free_first[i];
    for (int k = 0; k < i - free_first[i]; ++k) others[k] -= entries[k] * value;
  }
}

double DirectSolver::diagonal(int row) const {
  const int p = place[row];
  return matrix[start[p] + static_cast<size_t>(p - first[p])];
}

double DirectSolver::along(const DirectRow &row) const {
  double sum = 0;
  for (const DirectRow::Side &side : row.sides) {
    if (side.body >= 0) sum += moved(side, velocity(side.body));
  }
  return sum;
}

void DirectSolver::push(const DirectRow &row, double impulse) {
  if (impulse == 0) return;
  for (const DirectRow::Side &side : row.sides) {
    if (side.body < 0) continue;
    const double *response = side.tree_response ? side.tree_response : side.response;
    double *v = &velocities[velocity_start[static_cast<size_t>(side.body)]];
    for (int k = 0; k < side.size; ++k) v[k] += response[k] * impulse;
  }
}

void DirectSolver::bound_friction(DirectRow &row) const {
  row.high = std::min(row.friction * std::max(rows[static_cast<size_t>(row.normal)].x, 0.0), row.cap);
  row.low = -row.high;
}

// Sets the bounds of friction from the normal impulses. Returns the largest change of an impulse that follows, as a velocity.
double DirectSolver::bound_frictions() {
  double change = 0;
  for (size_t i = 0; i < rows.size(); ++i) {
    DirectRow &row = rows[i];
    if (row.normal < 0) continue;
    const double before = row.high;
    bound_friction(row);
    const double moved = row.state == DirectRow::Free ? std::fabs(row.x) - row.high : std::fabs(row.high - before);
    change = std::max(change, moved * diagonal(static_cast<int>(i)));
  }
  return change;
}

// Moves rows that break their bounds onto them, and rows that pull away from their bounds off them; all, or the last one only.
// Returns how many there were.
int DirectSolver::flip(bool single) {
  int count = 0, last = -1;
  DirectRow::State last_state = DirectRow::Free;
  for (int p = 0; p < static_cast<int>(rows.size()); ++p) {
    DirectRow &row = rows[order[p]];
    DirectRow::State state = row.state;
    if (state == DirectRow::Free) {
      const double slack = tolerance / diagonal(order[p]);
      if (row.x < row.low - slack) state = DirectRow::Low;
      if (row.x > row.high + slack) state = DirectRow::High;
    } else if (row.low < row.high) {
      const double excess = along(row) + row.cfm * row.x - row.target;
      if (state == DirectRow::Low ? excess < -tolerance : excess > tolerance) state = DirectRow::Free;
    }
    if (state == row.state) continue;
    ++count;
    last = order[p];
    last_state = state;
    if (!single) row.state = state;
  }
  if (single && last >= 0) rows[last].state = last_state;
  return count;
}

// Rounds of block pivoting with friction bounds that follow. Fast where few rows change sides; may cycle.
bool DirectSolver::pivot(int max_rounds) {
  bool stale = true, solved = false;
  int best = static_cast<int>(rows.size()) + 1, patience = 4;
  for (int round = 0; round < max_rounds && !solved; ++round) {
    if (stale) factor();
    take_free();
    const double moved = bound_frictions();
    const int broken = flip(patience <= 0);
    if (broken < best) {
      best = broken;
      patience = 4;
    } else {
      --patience;
    }
    stale = broken > 0;
    solved = !broken && moved <= tolerance;
  }
  return solved;
}

// What solves the rows between their bounds.
void DirectSolver::take_free() {
  settle();
  solve_free();
  for (size_t i = 0; i < free_rows.size(); ++i) {
    DirectRow &row = rows[static_cast<size_t>(free_rows[i])];
    row.x = unknowns[i];
    push(row, row.x);
  }
}

// Block pivoting within fixed bounds, as long as fewer and fewer rows are wrong.
bool DirectSolver::exchange() {
  int best = static_cast<int>(rows.size()) + 1, patience = 3;
  while (budget-- > 0) {
    factor();
    take_free();
    const int broken = flip(false);
    if (broken == 0) return true;
    if (broken < best) {
      best = broken;
      patience = 3;
    } else if (--patience < 0) {
      return false;
    }
  }
  return false;
}

// The same by a primal active-set method: from one point between the bounds to a better one, a row at a time, which ends.
bool DirectSolver::descend() {
  for (DirectRow &row : rows) {
    row.x = std::min(std::max(row.x, row.low), row.high);
    row.state = row.x <= row.low ? DirectRow::Low : row.x >= row.high ? DirectRow::High : DirectRow::Free;
  }
  while (budget-- > 0) {
    factor();
    settle();
    solve_free();
    // As far as the first bound.
    double step = 1;
    DirectRow *stopped = nullptr;
    for (size_t i = 0; i < free_rows.size(); ++i) {
      DirectRow &row = rows[static_cast<size_t>(free_rows[i])];
      const double way = unknowns[i] - row.x, room = (way > 0 ? row.high : row.low) - row.x;
      if (std::fabs(way) <= std::fabs(room) || room / way >= step) continue;
      step = room / way;
      stopped = &row;
      stopped->state = way > 0 ? DirectRow::High : DirectRow::Low;
    }
    for (size_t i = 0; i < free_rows.size(); ++i) {
      DirectRow &row = rows[static_cast<size_t>(free_rows[i])];
      row.x += step * (unknowns[i] - row.x);
      if (&row != stopped) row.state = DirectRow::Free;
    }
    if (stopped) {
      stopped->x = stopped->state == DirectRow::High ? stopped->high : stopped->low;
      continue;
    }
    accumulate();
    // Off its bound goes what pulls away from it the most.
    double most = tolerance;
    DirectRow *loosened = nullptr;
    for (DirectRow &row : rows) {
      if (row.state == DirectRow::Free || row.low >= row.high) continue;
      const double excess = along(row) + row.cfm * row.x - row.target;
      const double wrong = row.state == DirectRow::Low ? -excess : excess;
      if (wrong <= most) continue;
      most = wrong;
      loosened = &row;
    }
    if (!loosened) return true;
    loosened->state = DirectRow::Free;
  }
  return false;
}

// Impulses within the bounds of friction and those bounds by turns (staggered projections: Kaufman, Sueda, James and Pai 2008).
bool DirectSolver::stagger() {
  bound_frictions();
  while (budget > 0) {
    if (!exchange() && !descend()) return false;
    if (bound_frictions() <= tolerance) return true;
  }
  return false;
}

// Velocities of the rows that stand on their bounds.
void DirectSolver::settle() {
  velocities.assign(velocity_start.back(), 0);
  for (DirectRow &row : rows) {
    if (row.state == DirectRow::Free) continue;
    row.x = row.state == DirectRow::High ? row.high : row.low;
    push(row, row.x);
  }
}

// Velocities of all impulses.
void DirectSolver::accumulate() {
  velocities.assign(velocity_start.back(), 0);
  for (const DirectRow &row : rows) push(row, row.x);
}

// One sweep of projected Gauss-Seidel. Returns the largest change, as a velocity.
double DirectSolver::sweep() {
  double largest = 0;
  for (const int i : order) {
    DirectRow &row = rows[i];
    if (row.normal >= 0) bound_friction(row);
    const double d = diagonal(i);
    if (d <= 0) continue;
    const double wanted = row.x + (row.target - along(row) - row.cfm * row.x) / d;
    const double x = std::min(std::max(wanted, row.low), row.high), change = x - row.x;
    if (change == 0) continue;
    row.x = x;
    push(row, change);
    largest = std::max(largest, std::fabs(change) * d);
  }
  return largest;
}

// What the impulses minimise within fixed bounds.
double DirectSolver::energy() const {
  double sum = 0;
  for (const DirectRow &row : rows) sum += row.x * ((along(row) + row.cfm * row.x) / 2 - row.target);
  return sum;
}

// Projected Gauss-Seidel with subspace minimisation (Silcowitz, Niebe and Erleben 2010): sweeps find which rows stand on their
// bounds, a factorisation solves the others. The energy never grows, so that the result is at least as good as that of the sweeps.
bool DirectSolver::polish(int max_rounds) {
  accumulate();
  for (int round = 0; round < max_rounds; ++round) {
    sweep();
    sweep();
    if (sweep() <= tolerance) return true;
    for (int inner = 0; inner < 3; ++inner) {
      for (DirectRow &row : rows) {
        row.state = row.x <= row.low ? DirectRow::Low : row.x >= row.high ? DirectRow::High : DirectRow::Free;
      }
      factor();
      const double before = energy();
      saved.resize(rows.size());
      for (size_t i = 0; i < rows.size(); ++i) saved[i] = rows[i].x;
      settle();
      solve_free();
      double step = 1;
      for (size_t i = 0; i < free_rows.size(); ++i) {
        DirectRow &row = rows[free_rows[i]];
        const double way = unknowns[i] - row.x, room = (way > 0 ? row.high : row.low) - row.x;
        if (std::fabs(way) > std::fabs(room)) step = std::min(step, room / way);
        row.x = std::min(std::max(unknowns[i], row.low), row.high);
      }
      accumulate();
      if (step == 1) break;
      if (energy() <= before) continue;
      // Too much was cut off: as far as the first bound it is downhill.
      for (size_t i = 0; i < free_rows.size(); ++i) {
        DirectRow &row = rows[free_rows[i]];
        const double old = saved[static_cast<size_t>(free_rows[i])];
        row.x = std::min(std::max(old + step * (unknowns[i] - old), row.low), row.high);
      }
      accumulate();
      break;
    }
  }
  sweep();
  return false;
}

void DirectSolver::restore_guess() {
  for (size_t i = 0; i < rows.size(); ++i) {
    DirectRow &row = rows[i];
    row.x = guess[i];
    if (row.normal >= 0) bound_friction(row);
    row.x = std::min(std::max(row.x, row.low), row.high);
  }
}

// Of rows that are faster than they may be. Returns whether there were any.
bool DirectSolver::lower_targets() {
  bool any = false;
  for (DirectRow &row : rows) {
    if (row.target <= row.most || row.x <= row.low || along(row) <= row.most + tolerance) continue;
    row.target = row.most;
    any = true;
  }
  return any;
}

bool DirectSolver::solve(int max_rounds) {
  // What is lowered slows others down too: a few times are enough.
  constexpr int TIMES = 4;
  assemble();
  for (int i = 0; i < TIMES; ++i) {
    if (!solve_targets(max_rounds)) return false;
    if (!lower_targets()) break;
  }
  return true;
}

bool DirectSolver::solve_targets(int max_rounds) {
  double scale = 0;
  bool bounded = false, finite = true;
  guess.resize(rows.size());
  for (size_t i = 0; i < rows.size(); ++i) {
    DirectRow &row = rows[i];
    // What need not move, like a contact that opens, doesn't count.
    if (row.low < 0 || row.target > 0) scale = std::max(scale, std::fabs(row.target));
    finite = finite && std::isfinite(row.target);
    bounded = bounded || row.low > -1e9 || row.high < 1e9;
    // The first bounds come from the guess of the normal impulse.
    if (row.normal >= 0) bound_friction(row);
    guess[i] = row.x;
  }
  if (!finite) return false;
  tolerance = 1e-9 * scale + 1e-14;
  rounds_ = 0;
  if (!pivot(bounded ? max_rounds : 1)) {
    tolerance = 1e-6 * scale + 1e-14;
    restore_guess();
    // A row at a time is too slow for many.
    constexpr double MOST_WORK = 1e7;
    budget = std::max(max_rounds, static_cast<int>(std::min(10.0 * max_rounds, MOST_WORK / (work + 1))));
    if (!stagger()) {
      restore_guess();
      polish(max_rounds);
    }
  }
  for (DirectRow &row : rows) {
    if (!std::isfinite(row.x)) return false;
    row.x = std::min(std::max(row.x, row.low), row.high);
  }
  accumulate();
  return true;
}
