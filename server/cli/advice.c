/* What a command line that means something else is told to use.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/advice.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

enum { WORD_BYTES = 32 };

struct pair {
    const char *name, *text;
};

/* What other programs call it. */
static const struct pair elsewhere[] = {{"percent", "ratio"},
                                        {"fraction", "ratio"},
                                        {"keep", "ratio"},
                                        {"factor", "ratio"},
                                        {"r", "ratio"},
                                        {"count", "points"},
                                        {"number", "points"},
                                        {"vertices", "points"},
                                        {"faces", "points"},
                                        {"triangles", "points"},
                                        {"target", "points"},
                                        {"p", "points"},
                                        {"voxel", "spacing"},
                                        {"voxel_size", "spacing"},
                                        {"grid", "spacing"},
                                        {"radius", "spacing"},
                                        {"distance", "spacing"},
                                        {"lod", "levels"},
                                        {"out", "output"},
                                        {"overwrite", "force"},
                                        {"y", "force"},
                                        {"jobs", "threads"},
                                        {"j", "threads"},
                                        {"t", "threads"},
                                        {"silent", "quiet"},
                                        {"tolerance", "max_deviation"},
                                        {"error", "max_deviation"},
                                        {"box", "crop"},
                                        {"bbox", "crop"},
                                        {"bounds", "crop"},
                                        {"filter", "where"},
                                        {"class", "where"},
                                        {"ascii", "encoding"},
                                        {"binary", "encoding"},
                                        {"closed", "surface"},
                                        {"watertight", "surface"},
                                        {"mesh", "outputs"}};

#define BY_ITS_NAME "inputs and outputs have no option of their own; use whittle INPUT OUTPUT.ply"
#define BY_ITS_END "the end of the output's name is its format; use whittle INPUT OUTPUT.las"
#define COMES_WITH_IT                                                                                                  \
    "completion comes with the installed programs, for bash, zsh and fish; use make install, or the package"

/* What isn't an option here. */
static const struct pair ways[] = {{"i", BY_ITS_NAME},
                                   {"in", BY_ITS_NAME},
                                   {"input", BY_ITS_NAME},
                                   {"file", BY_ITS_NAME},
                                   {"to", BY_ITS_END},
                                   {"format", BY_ITS_END},
                                   {"type", BY_ITS_END},
                                   {"ext", BY_ITS_END},
                                   {"completion", COMES_WITH_IT},
                                   {"completions", COMES_WITH_IT}};

/* The option's name with '_' for '-': of a letter what stands before the number that may follow it, as in -j4. */
static void word_of(const char *argument, char word[WORD_BYTES]) {
    bool is_long = argument[1] == '-';
    const char *name = argument + 1 + is_long;
    size_t length = strcspn(name, "=");
    if (!is_long && length > 1 && (isdigit((unsigned char)name[1]) || name[1] == '.')) length = 1;
    snprintf(word, WORD_BYTES, "%.*s", (int)(length < WORD_BYTES ? length : WORD_BYTES - 1), name);
    for (char *c = word; *c; c++)
        if (*c == '-') *c = '_';
}

static const char *look_up(const struct pair *pairs, size_t count, const char *argument) {
    char word[WORD_BYTES];
    word_of(argument, word);
    for (size_t i = 0; i < count; i++)
        if (strcasecmp(pairs[i].name, word) == 0) return pairs[i].text;
    return NULL;
}

const char *advice_option(const char *argument) {
    return look_up(elsewhere, sizeof elsewhere / sizeof *elsewhere, argument);
}

const char *advice_way(const char *argument) { return look_up(ways, sizeof ways / sizeof *ways, argument); }

/* ------------------------------------------------------------------------------------------------ values */

static bool is_number(const char *text) {
    char *end;
    strtod(text, &end);
    return end > text && !*end;
}

/* Digits, and commas or points between them: as people write thousands and decimals. */
static bool has_comma(const char *text) {
    return strchr(text, ',') && text[strspn(text, "0123456789.,")] == 0 && text[strlen(text) - 1] != ',';
}

/* A number and letters behind it: 5mm, 10k. */
static bool has_letters(const char *text) {
    char *end;
    strtod(text, &end);
    return end > text && isalpha((unsigned char)*end);
}

static bool is_list(enum param_type type) {
    return type != PARAM_NUMBER && type != PARAM_INTEGER && type != PARAM_CHOICE;
}

/* In the place of what is allowed where that is a long list of names. */
static void add_use(const char *use, bool names, struct error *error) {
    char *allowed = strstr(error->text, "; it takes");
    size_t used = names && allowed ? (size_t)(allowed - error->text) : strlen(error->text);
    snprintf(error->text + used, sizeof error->text - used, "; %s", use);
}

void advice_on_value(const struct param *param, const char *value, const char *next, struct error *error) {
    const char *use = NULL;
    bool is_share = param->type == PARAM_NUMBER && param->max == 1;
    size_t length = strlen(value);
    if (is_share && is_number(value) && strtod(value, NULL) > 1)
        use = "use % for percent, as 10%";
    else if (param->type == PARAM_NUMBER && has_comma(value))
        use = "use a decimal point, as 0.1";
    else if (param->type == PARAM_INTEGER && length > 1 && value[length - 1] == '%')
        use = "use --ratio for a share, as --ratio 10%";
    else if (param->type == PARAM_INTEGER && (has_comma(value) || has_letters(value)))
        use = "use digits alone, as 10000";
    else if (param->type == PARAM_NUMBER && !is_share && has_letters(value))
        use = "use a number alone, in the file's units";
    else if (is_list(param->type) && next && (is_number(next) || (length && value[length - 1] == ',')))
        use = "use commas without blanks";
    if (use) add_use(use, param->type == PARAM_FLAGS, error);
}

/* ------------------------------------------------------------------------------------------------ names */

bool advice_on_name(const char *name, struct error *error) {
    char word[WORD_BYTES];
    size_t length = strcspn(name, "=");
    if (access(name, F_OK) == 0) return false;
    if (strncmp(name, "http://", 7) == 0 || strncmp(name, "https://", 8) == 0) {
        error_set(error, STATUS_BAD_PARAMETER, name,
                  "files are read, no addresses; use curl -sS URL | whittle - OUTPUT.ply");
        return true;
    }
    if (name[length] != '=' || length >= WORD_BYTES) return false;
    snprintf(word, sizeof word, "%.*s", (int)length, name);
    if (!params_find(word)) return false;
    error_set(error, STATUS_BAD_PARAMETER, name, "options begin with two dashes; use --%s", name);
    return true;
}
