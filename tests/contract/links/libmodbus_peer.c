/* A Modbus client and server by libmodbus: libmodbus_peer client|server tcp|rtu PORT-OR-PATH.
   The client reads the bench's input registers, gives the order in five words and a nonce, and reads it back.
   The server holds a load frame that stands still, in the bench's registers; over TCP it prints its port. */
#include <arpa/inet.h>
#include <errno.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

static void print_words(const char *what, const uint16_t *words, int count) {
    printf("%s", what);
    for (int i = 0; i < count; i++) printf(" %04x", words[i]);
    printf("\n");
}

static int fail(const char *what) {
    fprintf(stderr, "%s: %s\n", what, modbus_strerror(errno));
    return 1;
}

static int client(modbus_t *link) {
    const uint16_t order[6] = {0x4316, 0x0000, 0x42c8, 0x0000, 1, 77}; /* 150 N at 100 N/s, go */
    uint16_t words[16];
    if (modbus_connect(link) == -1) return fail("connect");
    if (modbus_read_input_registers(link, 0, 16, words) != 16) return fail("read");
    print_words("inputs", words, 16);
    if (modbus_write_registers(link, 0, 6, order) != 6) return fail("write");
    if (modbus_read_registers(link, 0, 6, words) != 6) return fail("read back");
    print_words("orders", words, 6);
    if (modbus_write_register(link, 4, 2) != 1) return fail("stop");
    if (modbus_read_input_registers(link, 16, 1, words) != -1) return 1;
    printf("beyond %d\n", errno == EMBXILADD);
    modbus_close(link);
    return 0;
}

static int server(modbus_t *link, int tcp) {
    static const uint16_t inputs[16] = {0x5e31, 1,      0, 0, 0xc148, 0x0000, 0x3e00, 0x0000,
                                        0x42c8, 0x0000, 0, 7, 0x0000, 0x0000, 0x44fa, 0x0000};
    uint8_t request[MODBUS_MAX_ADU_LENGTH];
    modbus_mapping_t *map = modbus_mapping_new(8, 8, 256, 256);
    memcpy(map->tab_input_registers, inputs, sizeof inputs);
    int listening = -1;
    if (tcp) {
        struct sockaddr_in name;
        socklen_t size = sizeof name;
        if ((listening = modbus_tcp_listen(link, 1)) == -1) return fail("listen");
        getsockname(listening, (struct sockaddr *)&name, &size);
        printf("%d\n", ntohs(name.sin_port));
    } else {
        if (modbus_connect(link) == -1) return fail("open");
        printf("0\n");
    }
    fflush(stdout);
    for (;;) {
        if (tcp && modbus_tcp_accept(link, &listening) == -1) return fail("accept");
        for (;;) {
            int length = modbus_receive(link, request);
            if (length > 0) modbus_reply(link, request, length, map);
            if (length == -1 && tcp) break;
        }
        modbus_close(link);
    }
}

int main(int count, char **arguments) {
    if (count != 4) return 2;
    int tcp = strcmp(arguments[2], "tcp") == 0;
    modbus_t *link = tcp ? modbus_new_tcp("127.0.0.1", atoi(arguments[3])) : modbus_new_rtu(arguments[3], 19200, 'N', 8, 1);
    modbus_set_slave(link, 1);
    modbus_set_response_timeout(link, 3, 0);
    return strcmp(arguments[1], "client") == 0 ? client(link) : server(link, tcp);
}
