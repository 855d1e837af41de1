/* The paper's contraction as it is written: one virtual edge at a time, always the cheapest of all.
 *
 * For reading beside the paper, and for tests to measure contraction in passes (core/simplify/contract.c) against.  No
 * program is linked with it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_REFERENCE_CONTRACT_H
#define WHITTLE_CORE_SIMPLIFY_REFERENCE_CONTRACT_H

#include "core/simplify/quadric.h"

/* Contracts the points of the neighbourhood until k are left, 1 <= k <= n: kept[0 .. k - 1], ascending.  quadrics: n,
 * each about its own point, as quadric_assemble makes them; borrowed.  O(n k log n) for k neighbours.  kept is
 * untouched on failure: STATUS_NO_MEMORY; STATUS_DEGENERATE where the virtual edges join too few points to go on. */
enum status reference_contract(const vec3 *point, const struct neighbourhood *neighbours,
                               const struct packed_quadric *quadrics, size_t k, uint32_t *kept) MUST_CHECK;

#endif
