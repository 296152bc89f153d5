/* The least that reading a log into memory and writing its CSI can take: threads read the file from the page cache in blocks of 4 MiB
 * into new memory, and write as many bytes of CSI (720 a record) and of columns and places (81) beside them. Nothing is computed.
 *
 * gcc -O3 -march=native -pthread read_floor.c -o read_floor && ./read_floor LOG RECORDS LARGE_PAGES STREAMED THREADS
 * LARGE_PAGES and STREAMED (stores past the caches; AVX-512) are 0 or 1. Prints seconds. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <immintrin.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { BLOCK = 4 << 20, PAGE = 2 << 20, CSI = 720, COLUMNS = 81 };

static int file, large, streamed;
static size_t size, records;
static char *bytes, *csi, *columns;
static size_t next_block;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static char *memory(size_t n) {
    n = (n + PAGE) & ~((size_t)PAGE - 1);
    char *p = mmap(0, n + PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (p == MAP_FAILED) exit(1);
    p = (char *)(((size_t)p + PAGE - 1) & ~((size_t)PAGE - 1));
    if (large) madvise(p, n, MADV_HUGEPAGE);
    return p;
}

static void fill(char *p, size_t n, int past_caches) {
    const __m512i value = _mm512_set1_epi8(3);
    p = (char *)((size_t)p & ~(size_t)63);
    for (size_t i = 0; i + 64 <= n; i += 64) {
        if (past_caches) _mm512_stream_si512((__m512i *)(p + i), value);
        else _mm512_storeu_si512(p + i, value);
    }
    _mm_sfence();
}

static void *work(void *unused) {
    for (;;) {
        const size_t from = __atomic_fetch_add(&next_block, 1, __ATOMIC_RELAXED) * BLOCK;
        if (from >= size) return unused;
        const size_t n = size - from < BLOCK ? size - from : BLOCK;
        for (size_t done = 0; done < n;) {
            const ssize_t got = pread(file, bytes + from + done, n - done, from + done);
            if (got <= 0) exit(1);
            done += got;
        }
        const double first = (double)from / size * records, many = (double)n / size * records;
        fill(csi + (size_t)(first * CSI), (size_t)(many * CSI), streamed);
        fill(columns + (size_t)(first * COLUMNS), (size_t)(many * COLUMNS), 0);
    }
}

int main(int count, char **words) {
    if (count != 6) return 2;
    file = open(words[1], O_RDONLY);
    if (file < 0) return 1;
    size = lseek(file, 0, SEEK_END);
    records = strtoul(words[2], 0, 10), large = atoi(words[3]), streamed = atoi(words[4]);
    const double began = now();
    bytes = memory(size), csi = memory(records * CSI), columns = memory(records * COLUMNS);
    pthread_t other;
    const int two = atoi(words[5]) == 2;
    if (two && pthread_create(&other, 0, work, 0)) return 1;
    work(0);
    if (two) pthread_join(other, 0);
    printf("%.4f\n", now() - began);
    return 0;
}
