/* Prints the irradiance that falls on a surface: `sample FILE.gdibl x y z nx ny nz`; without numbers, one query a line from
 * standard input, `x,y,z,nx,ny,nz`. Out: red, green, blue, and the share that was baked rather than filled.
 *
 *     cargo build --release -p gdibl-runtime-c
 *     cc -std=c99 -I crates/runtime-c/include crates/runtime-c/examples/sample.c target/release/libgdibl_runtime_c.a \
 *        -lpthread -ldl -lm -o sample
 */
#include "gdibl.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* All bytes of a file; NULL if it cannot be read. */
static uint8_t *read_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        return NULL;
    }
    size_t capacity = 1 << 16, length = 0;
    uint8_t *bytes = malloc(capacity);
    while (bytes != NULL) {
        length += fread(bytes + length, 1, capacity - length, file);
        if (length < capacity) {
            break;
        }
        uint8_t *larger = realloc(bytes, capacity *= 2);
        if (larger == NULL) {
            free(bytes);
        }
        bytes = larger;
    }
    if (ferror(file)) {
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    *size = length;
    return bytes;
}

static int print_irradiance(const GdiblVolume *volume, const double query[6])
{
    const float normal[3] = {(float)query[3], (float)query[4], (float)query[5]};
    GdiblSample sample;
    float irradiance[3];
    if (gdibl_sample_f64(volume, query, normal, &sample) != GDIBL_STATUS_OK
        || gdibl_irradiance_f64(volume, query, normal, irradiance) != GDIBL_STATUS_OK) {
        return 0;
    }
    if (!sample.inside) {
        fprintf(stderr, "outside the volume: this is its nearest place\n");
    }
    /* A surface reflects albedo / pi of this. */
    printf("%.9g,%.9g,%.9g,%.9g\n", irradiance[0], irradiance[1], irradiance[2], sample.validity);
    return 1;
}

/* Reads six numbers, with a comma or space after each but the last. */
static int parse_query(const char *text, double query[6])
{
    for (int k = 0; k < 6; k++) {
        char *end;
        query[k] = strtod(text, &end);
        if (end == text) {
            return 0;
        }
        text = end + (*end == ',');
    }
    return text[strspn(text, " \r\n")] == '\0';
}

static int answer(const GdiblVolume *volume, const char *text)
{
    double query[6];
    if (!parse_query(text, query)) {
        fprintf(stderr, "found \"%s\", expected six numbers: position x,y,z, unit normal x,y,z\n", text);
        return 0;
    }
    return print_irradiance(volume, query);
}

int main(int argc, char **argv)
{
    if (argc != 2 && argc != 8) {
        fprintf(stderr, "usage: sample FILE.gdibl [x y z nx ny nz]\n");
        return 2;
    }
    size_t size = 0;
    uint8_t *bytes = read_file(argv[1], &size);
    if (bytes == NULL) {
        fprintf(stderr, "%s: cannot be read\n", argv[1]);
        return 1;
    }
    GdiblVolume *volume;
    char message[256];
    GdiblStatus status = gdibl_parse(bytes, size, &volume, message, sizeof message);
    free(bytes);
    if (status != GDIBL_STATUS_OK) {
        fprintf(stderr, "%s: %s\n", argv[1], message);
        return status == GDIBL_STATUS_UNSUPPORTED ? 4 : 3;
    }

    GdiblHeader header;
    gdibl_header(volume, &header);
    fprintf(stderr, "%s: %zu nodes, L%u, from %g %g %g to %g %g %g\n", argv[1], gdibl_node_count(volume),
            (unsigned)header.bands, header.min[0], header.min[1], header.min[2], header.max[0], header.max[1],
            header.max[2]);

    int good = 1;
    char line[512];
    if (argc == 8) {
        int length = snprintf(line, sizeof line, "%s,%s,%s,%s,%s,%s", argv[2], argv[3], argv[4], argv[5], argv[6], argv[7]);
        good = length >= 0 && (size_t)length < sizeof line && answer(volume, line);
    } else {
        while (good && fgets(line, sizeof line, stdin) != NULL) {
            good = answer(volume, line);
        }
    }
    gdibl_free(volume);
    return good ? 0 : 2;
}
