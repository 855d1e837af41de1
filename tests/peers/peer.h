/* What all peers share: the command line, the clock, and the search for a parameter that yields a count.
 *
 *     peer METHOD INPUT.ply COUNT OUTPUT.ply
 *
 * prints one line of JSON: {"points": 4848, "ms": 12.5, "processor_ms": 24.8}.  The clocks run around the library's
 * work alone: neither files nor the conversion to the library's own types count.  Methods that take a size instead of a
 * count are run again and again until the size fits; only the run that is kept is timed, which is in their favour.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_PEERS_PEER_H
#define WHITTLE_TESTS_PEERS_PEER_H

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <exception>
#include <functional>

#include "tests/peers/ply.h"

namespace peer {

/* On the wall, and of all threads together. */
struct spent {
    double ms = 0, processor_ms = 0;
};

struct outcome {
    surface made;
    spent time;
};

struct method {
    const char *name;
    outcome (*run)(const surface &input, std::size_t count);
};

/* How long work() takes. */
inline spent time_of(const std::function<void()> &work) {
    auto start = std::chrono::steady_clock::now();
    std::clock_t processor = std::clock();
    work();
    return {std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count(),
            1e3 * double(std::clock() - processor) / CLOCKS_PER_SEC};
}

/* The diagonal of the bounding box. */
inline double diagonal(const surface &s) {
    double square = 0;
    for (int axis = 0; axis < 3; axis++) {
        auto [low, high] = std::minmax_element(s.vertex.begin(), s.vertex.end(),
                                               [axis](const auto &a, const auto &b) { return a[axis] < b[axis]; });
        square += ((*high)[axis] - (*low)[axis]) * ((*high)[axis] - (*low)[axis]);
    }
    return std::sqrt(square);
}

/* How many triangles leave count vertices: V - T / 2 is what a collapse of a closed mesh keeps. */
inline std::size_t triangles_for(const surface &s, std::size_t count) {
    std::size_t kept = 2 * count + s.triangle.size();
    return kept > 2 * s.vertex.size() ? kept - 2 * s.vertex.size() : 0;
}

/* Bisects (geometrically) between low and high for the size whose outcome has the count nearest to the one wanted; the
 * larger the size, the fewer the points. */
inline outcome search(std::size_t count, double low, double high, const std::function<outcome(double)> &run) {
    outcome best;
    auto off = [count](const outcome &o) { return std::abs(double(o.made.vertex.size()) - double(count)); };
    for (int step = 0; step < 24 && (best.made.vertex.empty() || off(best) > 0.001 * double(count)); step++) {
        double size = std::sqrt(low * high);
        outcome next = run(size);
        (next.made.vertex.size() > count ? low : high) = size;
        if (best.made.vertex.empty() || off(next) < off(best)) best = std::move(next);
    }
    return best;
}

/* main() of a peer. */
template <std::size_t n> int main(int argc, char **argv, const method (&methods)[n]) {
    const method *end = methods + n;
    const method *chosen =
        argc == 5 ? std::find_if(methods, end, [&](const method &m) { return m.name == std::string(argv[1]); }) : end;
    if (chosen == end) {
        std::fprintf(stderr, "Usage: %s METHOD INPUT.ply COUNT OUTPUT.ply\nMethods:", argv[0]);
        for (const method &m : methods) std::fprintf(stderr, " %s", m.name);
        std::fputc('\n', stderr);
        return 2;
    }
    try {
        outcome o = chosen->run(ply::read(argv[2]), std::stoul(argv[3]));
        ply::write(argv[4], o.made);
        std::printf("{\"points\": %zu, \"ms\": %.3f, \"processor_ms\": %.3f}\n", o.made.vertex.size(), o.time.ms,
                    o.time.processor_ms);
        return 0;
    } catch (const std::exception &e) {
        std::fprintf(stderr, "%s: %s: %s\n", argv[0], argv[1], e.what());
        return 1;
    }
}

} // namespace peer

#endif
