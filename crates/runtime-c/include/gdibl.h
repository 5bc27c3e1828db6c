/*
 * Reads .gdibl irradiance volumes and reconstructs light from them, in a game, per object or per pixel.
 *
 *     GdiblVolume *volume;
 *     char message[256];
 *     if (gdibl_parse(bytes, byte_count, &volume, message, sizeof message) != GDIBL_STATUS_OK) {
 *         fprintf(stderr, "level.gdibl: %s\n", message);
 *     }
 *     float irradiance[3];
 *     gdibl_irradiance(volume, position, normal, irradiance);
 *     for (int c = 0; c < 3; c++) {
 *         diffuse[c] = albedo[c] / PI * fmaxf(irradiance[c], 0.0f);   // here is the 1/pi
 *     }
 *     gdibl_free(volume);
 *
 * Units       Metres, the level's coordinates: glTF's, right-handed, Y up. Normals have unit length. Colour is linear
 *             Rec.709: red, green, blue. Irradiance E is what falls on a surface; a Lambertian surface reflects
 *             albedo / pi * E. White surroundings of radiance L give E = pi L. E may ring a little below 0 on the side
 *             away from something very bright: clamp where you shade, not where you still add lights up.
 * Ownership   gdibl_parse copies what it needs, so that the bytes may go right after; the volume is the caller's until
 *             gdibl_free. All other memory is the caller's.
 * Threads     A volume does not change: any number of threads may ask it at once. gdibl_free needs it alone.
 * Errors      Functions that may fail return a GdiblStatus; then what they write to is left as it was (gdibl_parse sets
 *             its volume to NULL). A null pointer is an error and not a crash. Damaged files are errors, and every file
 *             is checked in whole when parsed. No panic crosses this interface. Running out of memory ends the program.
 * Odd numbers A coordinate that is not a number counts as the box's lowest; outside the box the nearest position in it
 *             answers. A normal that is not a number gives an irradiance that is not a number.
 *
 * Written by cbindgen from crates/runtime-c/src/lib.rs: change that.
 */

#ifndef GDIBL_H
#define GDIBL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// Most spherical harmonics coefficients of a volume: those of bands 0 to 4.
#define GDIBL_MAX_COEFFICIENTS 25

// How a call went.
typedef enum {
  // Well.
  GDIBL_STATUS_OK = 0,
  // The file may be whole, but this library does not know what it uses: a newer version, another encoding, a codec
  // that was left out of this build.
  GDIBL_STATUS_UNSUPPORTED = 1,
  // The file is damaged, or was never a volume.
  GDIBL_STATUS_INVALID = 2,
  // A pointer is NULL that must not be.
  GDIBL_STATUS_NULL_POINTER = 3,
  // A number is too large: a node that the volume does not have, bands above 4. Or it makes no sense, see gdibl_set.
  GDIBL_STATUS_OUT_OF_RANGE = 4,
  // A mistake of this library: please report it.
  GDIBL_STATUS_INTERNAL = 5,
} GdiblStatus;

// What the nodes of a volume are.
typedef enum {
  // A regular grid; light between the nodes is interpolated.
  GDIBL_KIND_GRID = 0,
  // Listed points; the nearest one answers.
  GDIBL_KIND_POINTS = 1,
  // Mesh vertices; the nearest one answers, among those at one place the one whose normal fits best.
  GDIBL_KIND_VERTICES = 2,
  // Some places of a fine grid, fewer where light is even; interpolated as in a grid.
  GDIBL_KIND_SPARSE = 3,
} GdiblKind;

// Several volumes of a level. Only ever behind a pointer that gdibl_set made.
typedef struct GdiblSet GdiblSet;

// A parsed file. Only ever behind a pointer that gdibl_parse made.
typedef struct GdiblVolume GdiblVolume;

// The fixed part of a file.
typedef struct {
  // What the nodes are.
  GdiblKind kind;
  // Grid: nodes per axis, the first on min and the last on max; x runs fastest, then y, then z. Otherwise: how
  // many, 1, 1.
  uint32_t counts[3];
  // The highest band of spherical harmonics, 0 to 4: (bands + 1)^2 coefficients.
  uint32_t bands;
  // Nodes that would ring have been windowed: irradiance is nowhere negative.
  bool is_deringed;
  // The box's lowest corner, metres.
  double min[3];
  // The box's highest corner, metres.
  double max[3];
} GdiblHeader;

// Light at a position, or at a node.
typedef struct {
  // The highest band, 0 to 4.
  uint32_t bands;
  // Radiance (not irradiance: gdibl_evaluate convolves) in spherical harmonics: red, green, blue of coefficient
  // l(l+1)+m; 0 above bands. Orthonormal real basis without the Condon-Shortley sign: 1, y, z, x, xy, yz, 3zz-1, xz,
  // xx-yy, then bands 3 and 4.
  float radiance[GDIBL_MAX_COEFFICIENTS][3];
  // The share of this that was baked rather than filled from neighbours, 0 to 1.
  float validity;
  // Whether the position is in the volume's box; otherwise this is the light at the nearest position in it.
  bool inside;
} GdiblSample;

// Which nodes are the vertices of which part of the level.
typedef struct {
  // Index of the glTF node.
  uint32_t node;
  // Index of the glTF mesh.
  uint32_t mesh;
  // Index of the primitive in the mesh.
  uint32_t primitive;
  // The first of its nodes in the volume; the others follow in the order of the primitive's vertices.
  uint32_t first;
  // How many there are.
  uint32_t count;
} GdiblVertexSet;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Reads a file, given all of its bytes, and checks all of it.
//
// On success *volume is to be given to gdibl_free once. Otherwise *volume is NULL, and message says where in the file
// what was found and what was expected: at most message_size bytes of UTF-8 with the final 0, cut off where it is
// longer; 256 are enough. On success it is empty. message may be NULL.
//
// `bytes` is NULL or has `byte_count` bytes; `volume` is NULL or can be written; `message` is NULL or has
// `message_size` bytes.
GdiblStatus gdibl_parse(const uint8_t *bytes,
                        size_t byte_count,
                        GdiblVolume **volume,
                        char *message,
                        size_t message_size);

// Ends a volume, which must not be used afterwards. NULL is fine.
//
// `volume` is NULL or came from `gdibl_parse`, was not freed yet, and nobody else uses it.
void gdibl_free(GdiblVolume *volume);

// The fixed part of the file.
//
// `volume` is NULL or alive; `header` is NULL or can be written.
GdiblStatus gdibl_header(const GdiblVolume *volume, GdiblHeader *header);

// How many nodes there are, at least 1; 0 for NULL.
//
// `volume` is NULL or alive.
size_t gdibl_node_count(const GdiblVolume *volume);

// Node number node, from 0: where it is, metres, and what is stored there. For engines that upload a volume.
//
// `volume` is NULL or alive; `position` is NULL or has three numbers; `sample` is NULL or can be written.
GdiblStatus gdibl_node(const GdiblVolume *volume, size_t node, double position[3], GdiblSample *sample);

// How many vertex sets there are; 0 for NULL, and unless the volume holds vertices.
//
// `volume` is NULL or alive.
size_t gdibl_vertex_set_count(const GdiblVolume *volume);

// Vertex set number index, from 0, in order of glTF node, mesh and primitive. For engines that give the vertices of a mesh
// their light.
//
// `volume` is NULL or alive; `set` is NULL or can be written.
GdiblStatus gdibl_vertex_set(const GdiblVolume *volume,
                             size_t index,
                             GdiblVertexSet *set);

// Irradiance on a surface at a position in metres with a unit normal: diffuse = albedo / pi * irradiance. Not clamped.
//
// `volume` is NULL or alive; the others are NULL or have three numbers. They may overlap.
GdiblStatus gdibl_irradiance(const GdiblVolume *volume,
                             const float position[3],
                             const float normal[3],
                             float irradiance[3]);

// The same for levels far from the origin, where a float is too coarse for a position.
//
// As for `gdibl_irradiance`.
GdiblStatus gdibl_irradiance_f64(const GdiblVolume *volume,
                                 const double position[3],
                                 const float normal[3],
                                 float irradiance[3]);

// Irradiance at count positions with as many normals, x y z after x y z, into count times red green blue. The result may
// be the array of positions or that of normals. Arrays of a count of 0 may be NULL. The same numbers as one call each, in less
// time, and fastest where places in one cell of the volume follow each other.
//
// `volume` is NULL or alive; the others are NULL or have `3 * count` numbers. They are the same or do not overlap.
GdiblStatus gdibl_irradiance_batch(const GdiblVolume *volume,
                                   size_t count,
                                   const float *positions,
                                   const float *normals,
                                   float *irradiance);

// Light from all around at a position in metres: gdibl_evaluate turns it into irradiance for any number of normals. The
// unit normal picks between vertices at one place, and between the two sides of a wall.
//
// `volume` is NULL or alive; `position` and `normal` are NULL or have three numbers; `sample` is NULL or can be written.
GdiblStatus gdibl_sample(const GdiblVolume *volume,
                         const float position[3],
                         const float normal[3],
                         GdiblSample *sample);

// The same for levels far from the origin.
//
// As for `gdibl_sample`.
GdiblStatus gdibl_sample_f64(const GdiblVolume *volume,
                             const double position[3],
                             const float normal[3],
                             GdiblSample *sample);

// Irradiance on a surface with a unit normal in the light of a sample.
//
// `sample` is NULL or was written by this library; the others are NULL or have three numbers.
GdiblStatus gdibl_evaluate(const GdiblSample *sample, const float normal[3], float irradiance[3]);

// Puts count volumes of a level together, in the order of its list (FORMAT.md, *Several volumes of a level*), each with
// its spacing of there, metres: an earlier one wins over a later one.
//
// On success *set is to be given to gdibl_set_free once, and the volumes are its own: nobody may use or free them any
// more. Otherwise *set is NULL, and the volumes stay the caller's. Only grids can be in a set (else
// GDIBL_STATUS_INVALID), there is at least one, each is given once, and spacings are numbers over 0 (else
// GDIBL_STATUS_OUT_OF_RANGE).
//
// `volumes` is NULL or has `count` pointers from `gdibl_parse`, which nobody else uses; `spacings` is NULL or has
// `count` numbers; `set` is NULL or can be written.
GdiblStatus gdibl_set(GdiblVolume *const *volumes, const double *spacings, size_t count, GdiblSet **set);

// Ends a set and its volumes, which must not be used afterwards. NULL is fine.
//
// `set` is NULL or came from `gdibl_set`, was not freed yet, and nobody else uses it.
void gdibl_set_free(GdiblSet *set);

// As gdibl_irradiance, of a set.
//
// `set` is NULL or alive; the others are NULL or have three numbers. They may overlap.
GdiblStatus gdibl_set_irradiance(const GdiblSet *set,
                                 const float position[3],
                                 const float normal[3],
                                 float irradiance[3]);

// The same for levels far from the origin.
//
// As for `gdibl_set_irradiance`.
GdiblStatus gdibl_set_irradiance_f64(const GdiblSet *set,
                                     const double position[3],
                                     const float normal[3],
                                     float irradiance[3]);

// As gdibl_irradiance_batch, of a set.
//
// `set` is NULL or alive; the others are NULL or have `3 * count` numbers. They are the same or do not overlap.
GdiblStatus gdibl_set_irradiance_batch(const GdiblSet *set,
                                       size_t count,
                                       const float *positions,
                                       const float *normals,
                                       float *irradiance);

// As gdibl_sample_f64, of a set. Its bands are those of the volume that has most, of those that count at the position.
//
// `set` is NULL or alive; `position` and `normal` are NULL or have three numbers; `sample` is NULL or can be written.
GdiblStatus gdibl_set_sample_f64(const GdiblSet *set,
                                 const double position[3],
                                 const float normal[3],
                                 GdiblSample *sample);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GDIBL_H */
