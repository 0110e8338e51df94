/* A counter of A and B as plain as C has it: what the least work on a trace costs.
 *
 *     decode FILE.csv          rows t_ns,a,b after one header line: edges, counts, illegal transitions
 *     decode --make N FILE.csv a trace of N edges, 2000 ns apart, 1000 counts forth and back
 *
 * gcc -O2 -o decode decode.c */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* By the state before (a + 2b) times four, plus the state now; 9 is illegal. */
static const signed char STEP[16] = {0, 1, -1, 9, -1, 0, 9, 1, 1, 9, 0, -1, 9, -1, 1, 0};

static int make(long edges, const char *name)
{
    static const int FORTH[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    FILE *out = fopen(name, "w");
    int at = 0;
    if (!out)
        return perror(name), 2;
    fprintf(out, "t_ns,a,b\n0,0,0\n");
    for (long n = 1; n <= edges; n++) {
        at = (at + (n / 1000 % 2 ? 3 : 1)) & 3;
        fprintf(out, "%ld,%d,%d\n", 2000 * n, FORTH[at][0], FORTH[at][1]);
    }
    return fclose(out) ? (perror(name), 2) : 0;
}

static int decode(const char *name)
{
    static char line[256];
    FILE *in = fopen(name, "r");
    long edges = -1, count = 0, illegal = 0;
    unsigned before = 0;
    unsigned long long last_ns = 0;
    if (!in || !fgets(line, sizeof line, in))
        return perror(name), 2;
    while (fgets(line, sizeof line, in)) {
        char *rest;
        unsigned long long t_ns = strtoull(line, &rest, 10);
        unsigned now = (rest[1] == '1') + 2 * (rest[3] == '1');
        int step = STEP[4 * before + now];
        if (edges >= 0 && t_ns <= last_ns)
            return fprintf(stderr, "time runs backwards at %llu ns\n", t_ns), 2;
        if (edges >= 0 && step == 9)
            illegal++;
        else if (edges >= 0)
            count += step;
        before = now;
        last_ns = t_ns;
        edges++;
    }
    printf("%ld edges, %ld counts, %ld illegal\n", edges, count, illegal);
    return fclose(in);
}

int main(int n, char **words)
{
    if (n == 4 && !strcmp(words[1], "--make"))
        return make(atol(words[2]), words[3]);
    if (n == 2)
        return decode(words[1]);
    return fprintf(stderr, "usage: decode FILE.csv | decode --make N FILE.csv\n"), 2;
}
