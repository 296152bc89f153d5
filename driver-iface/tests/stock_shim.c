/* The module's code as a program: reads streams of packets, writes messages and counts. For tests/stock.rs. */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint8_t u8;
typedef uint16_t u16;
typedef uint32_t u32;

#include "csi5300_records.h"

static void get(void *to, size_t len)
{
	if (len && fread(to, len, 1, stdin) != 1)
		exit(feof(stdin) ? 0 : 2);
}

static void put(const void *from, size_t len)
{
	if (len && fwrite(from, len, 1, stdout) != 1)
		exit(3);
}

/* A stream is: u8 layout, u8 log, u32 packets, and for each u32 command, length, seconds, microseconds, and the data. */
int main(void)
{
	for (;;) {
		struct options options;
		struct card card;
		u32 packets, head[4];
		u8 *answer = NULL;
		size_t answered = 0;

		memset(&card, 0, sizeof(card));
		get(&options.layout, 1);
		get(&options.log, 1);
		get(&packets, sizeof(packets));
		while (packets--) {
			struct message out;
			u32 len = 0;
			u8 *data;

			get(head, sizeof(head));
			/* Exactly this size, so that the sanitizer detects a read beyond it. */
			data = malloc(head[1] ? head[1] : 1);
			get(data, head[1]);
			memset(&out, 0xa5, sizeof(out));
			if (assemble(&card, &options, head[0], head[1] ? data : data + 1, head[1], head[2], head[3], &out))
				len = 1 + out.head_len + out.tail_len;
			answer = realloc(answer, answered + sizeof(len) + len);
			memcpy(answer + answered, &len, sizeof(len));
			answered += sizeof(len);
			if (len) {
				answer[answered++] = out.code;
				memcpy(answer + answered, out.head, out.head_len);
				answered += out.head_len;
				memcpy(answer + answered, out.tail, out.tail_len);
				answered += out.tail_len;
			}
			free(data);
		}
		put(answer, answered);
		put(&card.counts, sizeof(card.counts));
		fflush(stdout);
		free(answer);
	}
}
