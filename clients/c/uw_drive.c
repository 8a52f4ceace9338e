/* Drive a uwserver from C99 and POSIX sockets alone: subscribe, send one command, print five samples.
 *
 *   uw_drive HOST PORT PATTERN ACTUATOR VALUE
 *   uw_drive 127.0.0.1 7600 bluerov2/imu bluerov2/thrusters '{"u":[0.3,0.3,-0.3,-0.3,0,0,0,0]}'
 *
 * The token, when the server asks for one, comes from the environment variable UWSERVER_TOKEN.
 * Exit status: 0 after five samples, 1 when something was refused or failed, 2 for wrong usage.
 */
#define _POSIX_C_SOURCE 200112L

#include <netdb.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/types.h>
#include <unistd.h>

enum { LINE_SIZE = 1 << 20, SAMPLES = 5, SILENCE_S = 10 };

static int connect_to(const char *host, const char *port)
{
    struct addrinfo hints, *found, *entry;
    struct timeval silence = {SILENCE_S, 0};
    int fd = -1;

    memset(&hints, 0, sizeof hints);
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host, port, &hints, &found) != 0)
        return -1;
    for (entry = found; entry != NULL; entry = entry->ai_next) {
        fd = socket(entry->ai_family, entry->ai_socktype, entry->ai_protocol);
        if (fd >= 0 && connect(fd, entry->ai_addr, entry->ai_addrlen) == 0)
            break;
        if (fd >= 0)
            close(fd);
        fd = -1;
    }
    freeaddrinfo(found);
    if (fd >= 0) /* a server that says nothing must not hold us for ever */
        setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence);
    return fd;
}

/* Send all of a text; the kernel may take it in parts. */
static int send_text(int fd, const char *text)
{
    size_t left = strlen(text);

    while (left > 0) {
        ssize_t sent = send(fd, text, left, 0);
        if (sent <= 0)
            return -1;
        text += sent;
        left -= (size_t)sent;
    }
    return 0;
}

/* Send one request line; `params` is JSON text. */
static int request(int fd, int id, const char *method, const char *params)
{
    char line[8192];
    int length = snprintf(line, sizeof line, "{\"jsonrpc\":\"2.0\",\"id\":%d,\"method\":\"%s\",\"params\":%s}\n", id,
                          method, params);

    return length < 0 || (size_t)length >= sizeof line ? -1 : send_text(fd, line);
}

/* Tell whether a line has `"key":` followed by `value`, with or without blanks between them. */
static int has_member(const char *line, const char *key, const char *value)
{
    size_t length = strlen(key);
    const char *place = line;

    while ((place = strstr(place, key)) != NULL) {
        place += length;
        place += strspn(place, " \t");
        if (*place == ':' && strncmp(place + 1 + strspn(place + 1, " \t"), value, strlen(value)) == 0)
            return 1;
    }
    return 0;
}

/* Look at one line: 1 for a sample (printed), -1 for a refusal (printed), 0 for anything else. */
static int look_at(const char *line)
{
    if (has_member(line, "\"method\"", "\"sample\"")) {
        puts(line);
        return 1;
    }
    if (!has_member(line, "\"method\"", "\"") && has_member(line, "\"error\"", "{")) {
        fprintf(stderr, "uw_drive: refused: %s\n", line);
        return -1;
    }
    return 0;
}

/* Read until five samples came. A read may end anywhere in a line, or hold many lines. */
static int print_samples(int fd)
{
    static char buffer[LINE_SIZE + 1];
    size_t held = 0;
    int samples = 0;

    while (samples < SAMPLES) {
        ssize_t got = recv(fd, buffer + held, LINE_SIZE - held, 0);
        char *line = buffer, *end;

        if (got <= 0) { /* also when one line fills the buffer */
            fprintf(stderr, "uw_drive: the connection ended or was silent for %d s\n", SILENCE_S);
            return -1;
        }
        held += (size_t)got;
        buffer[held] = '\0';
        while (samples < SAMPLES && (end = strchr(line, '\n')) != NULL) {
            int seen;

            *end = '\0';
            seen = look_at(line);
            if (seen < 0)
                return -1;
            samples += seen;
            line = end + 1;
        }
        held -= (size_t)(line - buffer);
        memmove(buffer, line, held);
    }
    return 0;
}

int main(int argc, char **argv)
{
    char text[4096];
    const char *token = getenv("UWSERVER_TOKEN");
    int fd, failed = 0;

    if (argc != 6) {
        fprintf(stderr, "usage: uw_drive HOST PORT PATTERN ACTUATOR VALUE\n"
                        "e.g.:  uw_drive 127.0.0.1 7600 bluerov2/imu bluerov2/thrusters '{\"u\":[0.3,0,0,0,0,0,0,0]}'\n");
        return 2;
    }
    fd = connect_to(argv[1], argv[2]);
    if (fd < 0) {
        fprintf(stderr, "uw_drive: no uwserver answers at %s:%s: start one with `uwserver run`\n", argv[1], argv[2]);
        return 1;
    }
    if (token != NULL && *token != '\0') {
        snprintf(text, sizeof text, "{\"version\":1,\"name\":\"uw_drive\",\"token\":\"%s\"}", token);
        failed |= request(fd, 1, "hello", text);
    }
    snprintf(text, sizeof text, "{\"pattern\":\"%s\"}", argv[3]);
    failed |= request(fd, 2, "subscribe", text);
    snprintf(text, sizeof text, "{\"port\":\"%s\",\"value\":%s}", argv[4], argv[5]);
    failed |= request(fd, 3, "command", text);
    if (failed)
        fprintf(stderr, "uw_drive: the request could not be sent\n");
    else
        failed = print_samples(fd);
    close(fd);
    return failed ? 1 : 0;
}
