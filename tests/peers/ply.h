/* The one format that the driver and the peers speak: binary little-endian PLY with double x y z, and triangles as
 * "list uchar int vertex_indices".  Whatever else comes in, the driver converts, so no peer suffers from the quirks of
 * its library's own reader.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_PEERS_PLY_H
#define WHITTLE_TESTS_PEERS_PLY_H

#include <array>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

struct surface {
    std::vector<std::array<double, 3>> vertex;
    std::vector<std::array<std::int32_t, 3>> triangle; /* empty: a cloud */
};

namespace ply {

constexpr std::size_t face_bytes = 1 + 3 * sizeof(std::int32_t);

/* Reads up to end_header; the two counts. */
inline std::array<std::size_t, 2> read_header(std::istream &in, const std::string &path) {
    std::array<std::size_t, 2> count{};
    std::string line;
    while (std::getline(in, line) && line != "end_header") {
        if (line.rfind("element vertex ", 0) == 0) count[0] = std::stoul(line.substr(15));
        if (line.rfind("element face ", 0) == 0) count[1] = std::stoul(line.substr(13));
        if (line.rfind("property float", 0) == 0) throw std::runtime_error(path + ": coordinates are not double");
    }
    if (!in) throw std::runtime_error(path + ": no end_header");
    return count;
}

inline surface read(const std::string &path) {
    std::ifstream in(path, std::ios::binary);
    if (!in) throw std::runtime_error(path + ": can't be opened");
    auto [vertices, faces] = read_header(in, path);
    surface s;
    s.vertex.resize(vertices);
    s.triangle.resize(faces);
    in.read(reinterpret_cast<char *>(s.vertex.data()), std::streamsize(vertices * sizeof s.vertex[0]));
    std::vector<char> body(faces * face_bytes);
    in.read(body.data(), std::streamsize(body.size()));
    if (!in) throw std::runtime_error(path + ": truncated");
    for (std::size_t f = 0; f < faces; f++) {
        if (body[f * face_bytes] != 3) throw std::runtime_error(path + ": a face is no triangle");
        std::memcpy(s.triangle[f].data(), &body[f * face_bytes + 1], sizeof s.triangle[f]);
    }
    return s;
}

inline void write(const std::string &path, const surface &s) {
    std::ofstream out(path, std::ios::binary);
    out << "ply\nformat binary_little_endian 1.0\nelement vertex " << s.vertex.size()
        << "\nproperty double x\nproperty double y\nproperty double z\n";
    if (!s.triangle.empty())
        out << "element face " << s.triangle.size() << "\nproperty list uchar int vertex_indices\n";
    out << "end_header\n";
    out.write(reinterpret_cast<const char *>(s.vertex.data()), std::streamsize(s.vertex.size() * sizeof s.vertex[0]));
    for (const auto &t : s.triangle) {
        out.put(3);
        out.write(reinterpret_cast<const char *>(t.data()), sizeof t);
    }
    if (!out.flush()) throw std::runtime_error(path + ": can't be written");
}

} // namespace ply

#endif
