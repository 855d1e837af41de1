/* --help, the manual page and the list for completion, from the same rows.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "core/base/version.h"
#include "core/io/sniff.h"
#include "core/params.h"
#include "server/shared/roff.h"

enum { TEXT_BYTES = 2048, WORD_BYTES = 64, WIDTH = 110 };

/* Options that aren't parameters, in the order of --help. */
static const struct own {
    char letter; /* 0: none */
    const char *name, *value /* as --help shows it; NULL: none */, *takes /* for completion */, *help;
} owns[] = {
    {'o', "output", "FOLDER|FILE|-", "FILE",
     "Where outputs go; files that are there are replaced. Default: the present folder, where none is. A name that "
     "ends in .ply, .xyz, .pcd, .las, .laz, .copc.laz, .obj, .stl, .glb, .png or .json is one file of that format: of "
     "the cloud, or of what --outputs names. Any other name is a folder, made if it isn't there. - writes one output "
     "to "
     "standard output "
     "(--outputs names it; default the cloud), and the summary to standard error. The input is never replaced"},
    {'f', "force", NULL, "", "Replace files that are there without -o, too"},
    {'n', "dry-run", NULL, "",
     "Read the input and tell what would be kept and written, the memory that it takes at most and about "
     "how long; write nothing; with --json as JSON"},
    {0, "preview", NULL, "",
     "Write preview.png too, and show it on the terminal, where that can; --preview=kitty, --preview=sixel and "
     "--preview=blocks show it that way wherever the output goes"},
    {0, "json", NULL, "", "Print the report, as report.json has it, to standard output in place of the summary"},
    {'q', "quiet", NULL, "", "Print no summary; warnings go to standard error"},
    {'v', "verbose", NULL, "", "Print the time of each stage, too"},
    {0, "memory", "BYTES", "VALUE",
     "The memory that may be used, as 4000000000, 4000M or 4G: more tetrahedra than it has room for are refused, as "
     "points along lines have; and a cloud that doesn't fit is simplified in tiles on disk. Default: that of the "
     "machine, or of ulimit"},
    {0, "scratch", "FOLDER", "FILE",
     "Where tiles of a cloud that doesn't fit into memory lie; after a stop or a crash the same command goes on from "
     "there, and at the end they are removed. Default: the output's name with .tiles"},
    {0, "tile-points", "N", "VALUE",
     "Points of a tile at most, as 500k or 8M; the result depends on it. Default: as memory has room for"},
    {0, "progress-fd", "N", "VALUE", "Tell progress and the end on this inherited descriptor, one line each"},
    {'h', "help", NULL, "", "Print the options"},
    {'V', "version", NULL, "", "Print the version"},
    {0, "man", NULL, "", "Print the manual page"},
};
enum { OWNS = sizeof owns / sizeof owns[0] };

/* Exit statuses of the command and of its commands. */
static const struct exit_row {
    const char *status, *meaning;
} exits[] = {
    {"0", "done"},
    {"64", "an option or a parameter is wrong"},
    {"65", "the input is malformed, degenerate or over a limit"},
    {"66", "the input isn't there, or can't be opened"},
    {"70", "internal error"},
    {"71", "out of memory"},
    {"73", "an output can't be made: it is the input, or there already, or its folder takes no files"},
    {"74", "reading or writing failed"},
    {"75", "stopped by a signal"},
};
enum { EXITS = sizeof exits / sizeof exits[0] };

void help_hyphens(const char *text, char *out, size_t out_bytes) {
    size_t used = 0;
    for (const char *at = text; *at && used + 1 < out_bytes;) {
        char word[WORD_BYTES];
        size_t length = 0;
        while (isalnum((unsigned char)at[length]) || at[length] == '_') length++;
        bool named = length > 0 && length < sizeof word;
        if (named) snprintf(word, sizeof word, "%.*s", (int)length, at);
        named = named && params_find(word);
        if (length == 0) length = 1;
        for (size_t i = 0; i < length && used + 1 < out_bytes; i++) out[used++] = named && at[i] == '_' ? '-' : at[i];
        at += length;
    }
    if (out_bytes) out[used] = 0;
}

/* Lines of at most WIDTH letters behind eight blanks. */
static void print_wrapped(const char *text) {
    for (const char *at = text; *at;) {
        size_t length = strlen(at);
        if (length > WIDTH)
            for (length = WIDTH; length > 1 && at[length] != ' ';) length--;
        printf("        %.*s\n", (int)length, at);
        for (at += length; *at == ' ';) at++;
    }
}

static void print_owns(void) {
    char text[TEXT_BYTES];
    for (size_t i = 0; i < OWNS; i++) {
        if (owns[i].letter)
            printf("  -%c, --%s", owns[i].letter, owns[i].name);
        else
            printf("  --%s", owns[i].name);
        printf(owns[i].value ? " %s\n" : "\n", owns[i].value);
        snprintf(text, sizeof text, "%s.", owns[i].help);
        print_wrapped(text);
    }
}

static void print_parameters(bool everyday) {
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char allowed[PARAMS_ALLOWED_BYTES], line[TEXT_BYTES], name[WORD_BYTES], text[TEXT_BYTES];
        if (params_is_everyday(&table[i]) != everyday) continue;
        params_allowed(&table[i], allowed, sizeof allowed);
        help_hyphens(table[i].name, name, sizeof name);
        printf("  --%s\n", name);
        snprintf(line, sizeof line, "%s.", table[i].help);
        help_hyphens(line, text, sizeof text);
        print_wrapped(text);
        snprintf(line, sizeof line, "%s%s%s%s%s", allowed, table[i].unit[0] ? "; in " : "", table[i].unit,
                 table[i].default_text[0] ? "; default " : "", table[i].default_text);
        print_wrapped(line);
    }
}

void help_print(void) {
    puts("Usage: whittle INPUT... OUTPUT.ply [--parameter value ...]       one file: ply, xyz, pcd, las, obj, glb ...\n"
         "       whittle INPUT... [--parameter value ...] [-o FOLDER/]        cloud.ply, report.json ...\n"
         "       whittle INPUT [--parameter value ...] [--outputs ONE] -o - in a pipe\n"
         "       whittle convert INPUT... OUTPUT.ply all points, in another format; see whittle convert --help\n"
         "       whittle info INPUT                  what a cloud is; see whittle info --help\n"
         "       whittle tiles plan|list|run|merge   a cloud that doesn't fit into memory, step by step; see whittle "
         "tiles "
         "--help\n"
         "       whittle measure A B [...]           distances between two clouds or meshes; see whittle measure "
         "--help\n"
         "\n"
         "Simplifies a point cloud, reconstructs its surface as a mesh and measures the error.");
    printf("Formats of INPUT: %s\n", cloud_sniff_titles());
    puts("(also CSV), compressed by gzip or zstd or not, told by its content; - is standard input. Several inputs are "
         "one\n"
         "cloud: attributes are joined by what they are called, and coordinate systems must be the same. Faces of the "
         "input\n"
         "become the surface that the mesh is measured against. OUTPUT is as for -o, but a file that is there is "
         "replaced by\n"
         "--force alone. Writes what --outputs asks for; report.json says what an output could not hold of the input. "
         "Words\n"
         "of an option may be joined by "
         "- or _.\n"
         "\n"
         "Options:");
    print_owns();
    puts("\nParameters for every day:");
    print_parameters(true);
    puts("\nAdvanced parameters:");
    print_parameters(false);
    puts("\nExit status:");
    for (size_t i = 0; i < EXITS; i++) printf("  %-3s %s\n", exits[i].status, exits[i].meaning);
}

void help_print_convert(void) {
    puts("Usage: whittle convert INPUT... OUTPUT [--crop LIST] [--where LIST] [--columns LIST] [--encoding E]\n"
         "                       [--colours BITS] [--pcd-precision P] [--header H] [--properties LIST]\n"
         "                       [-o OUTPUT] [-f] [-n] [-q]\n"
         "\n"
         "Writes all points of the inputs, in their order, in the format that OUTPUT ends in: .ply, .xyz, .pcd, .las,\n"
         ".laz, .copc.laz (by cubes, not in their order), and where the input has faces .obj, .stl or .glb, and .ply\n"
         "with them. Properties are kept bit for bit where the format can hold them; what it can't hold is printed.\n"
         "Coordinates are not moved. Nothing is simplified and no surface is made. A file that is there is replaced "
         "with\n"
         "-o or --force; the input never. -o - writes to standard output what --outputs names, as cloud.pcd.\n"
         "Options as in whittle --help.\n"
         "\n"
         "Exit status: as whittle's.");
}

/* ------------------------------------------------------------------------------------------------ the manual page */

static void print_man_owns(void) {
    for (size_t i = 0; i < OWNS; i++) {
        puts(".TP");
        if (owns[i].letter) printf("\\fB\\-%c\\fR, ", owns[i].letter);
        printf("\\fB");
        char option[WORD_BYTES];
        snprintf(option, sizeof option, "--%s", owns[i].name);
        roff_print(option);
        printf("\\fR");
        if (owns[i].value) {
            printf(" \\fI");
            roff_print(owns[i].value);
            printf("\\fR");
        }
        putchar('\n');
        roff_print(owns[i].help);
        puts(".");
    }
}

static void print_man_parameters(bool everyday) {
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char allowed[PARAMS_ALLOWED_BYTES], name[WORD_BYTES], text[TEXT_BYTES];
        if (params_is_everyday(&table[i]) != everyday) continue;
        params_allowed(&table[i], allowed, sizeof allowed);
        help_hyphens(table[i].name, name, sizeof name);
        help_hyphens(table[i].help, text, sizeof text);
        printf(".TP\n\\fB\\-\\-");
        roff_print(name);
        printf("\\fR \\fIvalue\\fR\n");
        roff_print(text);
        puts(".");
        printf("Takes ");
        roff_print(allowed);
        if (table[i].unit[0]) printf(", in %s", table[i].unit);
        printf(table[i].default_text[0] ? "; default %s.\n" : ".\n", table[i].default_text);
    }
}

void help_print_man(void) {
    printf(".\\\" SPDX-License-Identifier: GPL-3.0-or-later\n.TH WHITTLE 1 \"\" \"whittle %s\" \"whittle\"\n",
           whittle_version());
    puts(".SH NAME\nwhittle \\- make point clouds small and keep their features\n.SH SYNOPSIS\n.B whittle\n"
         ".IR input \" ...\"\n.RI [ output ]\n.RI [ \\-\\-parameter\\~value \"...] [\" \\-o\\~output ]\n"
         ".br\n.B whittle convert\n.IR input \" ... output\"\n.br\n.B whittle info\n.I input\n.br\n.B whittle "
         "measure\n.I a b\n"
         ".br\n.B whittle tiles\n.I plan|list|run|merge\n"
         ".SH DESCRIPTION\nSimplifies a point cloud, reconstructs a mesh of its surface where asked for, and "
         "measures\n"
         "the error.  The kind of the input is told by its content; \\- is standard input.\n"
         "What is written,\n.B \\-\\-outputs\nsays; the points of a cloud come in the order of their importance.\n"
         "Several inputs are one cloud.\nThe last of several names is the output, as after\n.BR \\-o ,\nbut a file of "
         "that name is replaced by\n"
         ".B \\-\\-force\nalone.\nWords of an option may be joined by \\- or _.\n.PP\n"
         ".B whittle convert\nwrites all points in another format,\n.B whittle info\ntells what a cloud is,\n"
         ".B whittle measure\nprints the distances between two clouds or meshes, and\n.B whittle tiles\nsimplifies a "
         "cloud "
         "that doesn't fit into memory step by step; see the \\-\\-help of each.\n"
         ".SH OPTIONS");
    print_man_owns();
    puts(".SH PARAMETERS FOR EVERY DAY");
    print_man_parameters(true);
    puts(".SH ADVANCED PARAMETERS");
    print_man_parameters(false);
    puts(".SH EXIT STATUS\nThose of\n.BR sysexits (3):");
    for (size_t i = 0; i < EXITS; i++) {
        printf(".TP\n%s\n", exits[i].status);
        roff_print(exits[i].meaning);
        puts(".");
    }
    puts(".SH EXAMPLES\n.EX\nwhittle scan.ply small.ply \\-\\-ratio 0.05\n"
         "whittle scan.ply \\-\\-ratio 0.1 \\-\\-outputs cloud,mesh,report \\-o out/\n"
         "whittle info scan.las\nwhittle convert scan.las scan.ply\n"
         "whittle measure out/mesh.ply scan.ply\n.EE\n.SH SEE ALSO\n.BR whittled (8)");
}

/* ------------------------------------------------------------------------------------------------ completion */

/* As much of it as a line of a menu has room for. */
static void print_brief(const char *help) {
    enum { BRIEF = 72 };
    char text[TEXT_BYTES];
    help_hyphens(help, text, sizeof text);
    size_t length = strlen(text);
    if (length > BRIEF)
        for (length = BRIEF; length > 1 && text[length] != ' ';) length--;
    printf("%.*s%s\n", (int)length, text, text[length] ? " ..." : "");
}

static void print_choices(const struct param *param) {
    for (size_t i = 0; param->choices[i]; i++) printf("%s%s", i ? "," : "", param->choices[i]);
}

void help_print_options(void) {
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char name[WORD_BYTES];
        help_hyphens(table[i].name, name, sizeof name);
        printf("--%s\t", name);
        if (table[i].choices)
            print_choices(&table[i]);
        else
            printf("VALUE");
        putchar('\t');
        print_brief(table[i].help);
    }
    for (size_t i = 0; i < OWNS; i++) {
        printf("--%s\t%s\t", owns[i].name, owns[i].takes);
        print_brief(owns[i].help);
    }
}
